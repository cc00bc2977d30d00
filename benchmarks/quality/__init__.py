"""Depth and held-out pictures of simulated people, by kind of depth, and what measuring them costs."""
