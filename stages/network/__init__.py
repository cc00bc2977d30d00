"""The PoseGaussian network: torch modules that refine the analytic depth and Gaussians; they open no files."""
