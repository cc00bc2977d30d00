"""A sequence of Gaussians as one HTML file that plays it: how its bytes are coded, and what the browser runs."""
