"""Source views left out and drawn from the others, candidate by candidate: what a capture itself says of a choice."""
