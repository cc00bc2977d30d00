"""The rasterizer of 3D Gaussians: one definition, three back ends."""
