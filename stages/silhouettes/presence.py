"""In which frames somebody is: of a person who comes late or goes early, the others tell nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from posegaussian.storage.model.masks import NEARLY_EMPTY, foreground

LOOKED_THROUGH = 15
"""Frames that are looked through for somebody."""


def shows_somebody(mask: np.ndarray) -> bool:
    """Whether a mask [h, w] uint8 holds somebody."""
    return bool(foreground(mask).mean() >= NEARLY_EMPTY)


def showing(
    numbers: Sequence[int] | np.ndarray, seeing: Callable[[int], int], most: int = LOOKED_THROUGH
) -> np.ndarray:
    """[m] int64: of at most so many of the ascending frame numbers [n], evenly, first and last included, those that
    show somebody: in which at least half as many views see one, `seeing` says how many, as in the best of them."""
    index = np.rint(np.linspace(0, len(numbers) - 1, min(len(numbers), most))).astype(int)
    looked_at = np.unique(np.asarray(numbers, np.int64)[index])
    counts = np.array([seeing(int(n)) for n in looked_at], np.int64)
    return looked_at[(counts > 0) & (2 * counts >= counts.max(initial=0))]


def with_somebody(
    numbers: np.ndarray,
    usual: np.ndarray,
    seeing: Callable[[int], int],
    views: int,
    most: int = LOOKED_THROUGH,
) -> np.ndarray:
    """Frame numbers [n] as they are where half of so many views see somebody in each of the `usual` ones, which are
    taken of them, or nobody is found in any; else those of them that are `showing` somebody."""
    if all(2 * seeing(int(n)) >= views for n in usual):
        return numbers
    found = showing(numbers, seeing, most)
    return found if len(found) else numbers
