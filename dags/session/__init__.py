"""What every command does first, and one run from start to end."""
