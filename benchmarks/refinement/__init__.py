"""Refinement beside per-scene optimisation from a plain start."""
