"""Joints: read, triangulated robustly across views, filled by reprojection, encoded as heatmaps."""
