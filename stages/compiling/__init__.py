"""Functions that numba compiles, and what they are compiled from."""
