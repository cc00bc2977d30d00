"""Measures and constants of a sequence, taken once from a recorded sample of its frames."""
