"""What planning, running and telling cost besides the work, and the memory of a run."""
