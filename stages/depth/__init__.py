"""Depth of every source view: stereo between neighbouring views, bounded by the visual hull."""
