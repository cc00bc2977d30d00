"""Refinement beside per-scene 3D Gaussian splatting."""
