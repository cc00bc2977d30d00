"""PoseGaussian: multi-view video of people becomes novel views."""
