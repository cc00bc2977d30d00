"""The refinement stage: the Gaussians of a frame, optimised on its source pictures through the renderer."""
