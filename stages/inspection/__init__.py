"""Is a capture usable? Measures of cameras, pairs, joints, light and focus, each with a verdict and what to do."""
