"""Captures out, one file a layout: undistorted pictures, masks, cameras and a cloud for other tools."""
