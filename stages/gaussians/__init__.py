"""Pixel-aligned Gaussian maps of every source view: the analytic prior."""
