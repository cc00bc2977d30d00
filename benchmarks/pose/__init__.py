"""Joints in space: of simulated people against the truth, of real video against joints that came with it."""
