"""Who is filmed: bodies, clothes, motions."""
