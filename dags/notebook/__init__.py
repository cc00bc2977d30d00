"""What `import posegaussian` gives a notebook: archives to read, Gaussians to draw, plans and runs."""
