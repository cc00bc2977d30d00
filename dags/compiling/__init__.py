"""Compiled kernels, as processes share them."""
