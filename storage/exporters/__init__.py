"""One file an output format: pictures of a run -> files people open."""
