"""How many frames' maps are read together: of large pictures a partition of many views would take gigabytes."""

from __future__ import annotations

AT_ONCE = 2**29
"""Bytes of all source views' maps that a kernel reads together: those of eight frames of eight views of 512 px, and of
one of 1080p."""


def read_together(partition: range, i: int, frame_bytes: int) -> range:
    """The frames of a partition that are read together with its frame i, of so many bytes each: neighbours in blocks
    that begin where the partition does, at least one."""
    count = max(1, AT_ONCE // max(frame_bytes, 1))
    first = partition.start + (i - partition.start) // count * count
    return range(first, min(first + count, partition.stop))


def bytes_together(frames: int, frame_bytes: int) -> int:
    """What frames that are read together take at most, of so many there are."""
    return max(frame_bytes, min(frames * frame_bytes, AT_ONCE))
