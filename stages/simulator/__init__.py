"""Captures the project makes itself, with ground truth."""
