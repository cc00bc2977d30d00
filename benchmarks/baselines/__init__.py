"""What others' methods reach on the same pictures and held-out views."""
