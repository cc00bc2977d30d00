"""What each choice is worth: variants trained and run, and their tables."""
