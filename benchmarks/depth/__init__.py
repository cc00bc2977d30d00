"""Depth: the offset sweep's cost, a measured stereo pair, and what a single camera gives."""
