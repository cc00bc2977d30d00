"""The GPU back end: Triton kernels."""
