"""File formats of other people: joints, PLY, splats."""
