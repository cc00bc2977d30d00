"""What a GPU makes of renderer, network, refinement, frames and training: one table, and what each part measures."""
