"""Training of the network: scenes become frames, frames become examples, examples become steps; all of it pure."""
