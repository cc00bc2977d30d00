"""Where pictures are rendered from."""
