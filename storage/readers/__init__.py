"""Lazy readers of pictures, videos and what else a capture refers to."""
