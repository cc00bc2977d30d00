"""Cameras, time, arrays and captures as data: all that stages may know of storage."""
