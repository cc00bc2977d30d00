"""Training of the network: steps, frames, checkpoints, cards."""
