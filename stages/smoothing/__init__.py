"""Temporal stabilisation of pose heatmaps (the paper's TPS)."""
