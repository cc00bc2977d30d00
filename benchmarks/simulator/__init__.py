"""The simulator: what its effects cost, and pictures of its cast."""
