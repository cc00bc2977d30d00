"""Models and weights of other people, and of our own."""
