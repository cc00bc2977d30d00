"""The depth methods, one a file: what each declares, and the function that computes it."""
