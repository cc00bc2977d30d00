"""The CPU back end: numba kernels."""
