"""Whether a capture is usable, as a page with pictures."""
