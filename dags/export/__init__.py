"""From finished pictures and Gaussians to files that people open."""
