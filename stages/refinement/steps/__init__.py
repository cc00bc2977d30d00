"""Steps of refinement: Gaussians as numbers, what a picture says of them, how they move; on the CPU and on a GPU."""
