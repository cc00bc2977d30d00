"""The part of a picture that holds something: what fills most of it with nothing is not worth computing."""

from __future__ import annotations

import numpy as np


def part_around(there: np.ndarray, beyond: int) -> tuple[slice, slice]:
    """The part of a picture [h, w] bool that holds something, and so many px `beyond` it; empty where nothing does."""
    rows, columns = np.flatnonzero(there.any(axis=1)), np.flatnonzero(there.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return (
        slice(max(int(rows[0]) - beyond, 0), int(rows[-1]) + beyond + 1),
        slice(max(int(columns[0]) - beyond, 0), int(columns[-1]) + beyond + 1),
    )
