"""Rigid motions, pairs, rectification, un/projection, visual hull, camera paths."""
