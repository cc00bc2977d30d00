"""Silhouettes together: the visual hull, and whether masks agree."""
