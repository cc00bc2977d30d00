"""What settings that were not tried would give, from those that were: a Gaussian process over the knobs' levels.

A knob's level is its place among its levels, from cheap to dear. Two settings are alike knob by knob, and as a whole:
the first lets what one knob does be learnt from settings that differ in others, the second what only some do together
(Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, chapters 2 and 5.4.1; additive kernels:
Duvenaud et al., 2011).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

Setting: TypeAlias = tuple[int, ...]
"""Which level each knob has."""
REACH = 2.0
"""Over how many times a knob's whole range likeness falls to 1/e."""
APART, TOGETHER = 1.0, 0.3
"""Variance of what each knob does for itself, and of what all do together, over that of what was found."""
NOISE = 1e-3
"""Variance of what is found, over the same: repeats of a picture are equal, its seconds nearly."""
NOTHING = 2e-3
"""Share of a stage's most seconds that counts as none: where it does not run there is no logarithm."""


def likeness(a: np.ndarray, b: np.ndarray, levels: Sequence[int]) -> np.ndarray:
    """[n, m] prior covariance of settings a [n, k] and b [m, k] of k knobs with so many `levels`."""
    apart, together = np.zeros((len(a), len(b))), np.ones((len(a), len(b)))
    for k, count in enumerate(levels):  # knob by knob: an array of all three would not fit where much was tried
        alike = np.exp(-np.abs(a[:, None, k] - b[None, :, k]) / max(count - 1, 1) / REACH)
        apart += alike
        together *= alike
    return APART * apart + TOGETHER * together


def predicted(
    tried: Sequence[Setting], found: np.ndarray, asked: Sequence[Setting], levels: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean [m] and standard deviation [m] of a number at the settings `asked`, from `found` [n] at those `tried`. Where
    all that was found is equal, all else is taken to be."""
    a, b = np.array(tried, float), np.array(asked, float)
    middle, spread = float(found.mean()), float(found.std())
    if spread == 0:
        return np.full(len(b), middle), np.zeros(len(b))
    own = likeness(a, a, levels) + NOISE * np.eye(len(a))
    shared = likeness(a, b, levels)
    solved = np.linalg.solve(own, np.column_stack([(found - middle) / spread, shared]))
    mean, explained = shared.T @ solved[:, 0], (shared * solved[:, 1:]).sum(axis=0)
    return middle + spread * mean, spread * np.sqrt(np.maximum(APART * len(levels) + TOGETHER - explained, 0))


def predicted_seconds(
    tried: Sequence[Setting], found: Sequence[Mapping[str, float]], asked: Sequence[Setting], levels: Sequence[int]
) -> np.ndarray:
    """[m] seconds a frame at the settings `asked`: the sum over stages, each told by the logarithm of its own, because
    a smaller picture takes a share of them whatever else is set."""
    total = np.zeros(len(asked))
    for stage in sorted({s for seconds in found for s in seconds}):
        own = np.array([seconds.get(stage, 0.0) for seconds in found])
        if own.max() > 0:
            total += np.exp(predicted(tried, np.log(np.maximum(own, NOTHING * own.max())), asked, levels)[0])
    return total
