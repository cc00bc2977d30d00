"""Splat rendering: lift the maps of the nearest source views to 3D Gaussians and rasterize them."""
