"""The simulator's renderer: triangles, rays, light, textures."""
