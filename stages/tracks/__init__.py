"""Everybody followed through the whole sequence."""
