"""Jitter and motion of given joints, from runs of consecutive frames: what is noise of the detector, what is the
person.

A person moves smoothly over four frames, a detector's noise does not: with white noise of standard deviation s per
coordinate, the third difference of a position has variance 20 s^2 per coordinate and hardly any of the motion.
"""

from __future__ import annotations

import numpy as np

RUN = 4
"""Consecutive frames of a run."""
SCORE = 0.3
"""Least score of a joint that counts."""
TRIMMED = 0.95
"""Share of the smallest steps whose mean square is the motion: a joint that jumps to another limb says nothing about
speed."""
MEDIAN_CHI2 = 1.3863
"""Median of a chi-square variable with two degrees of freedom, 2 ln 2."""


def run_starts(numbers: np.ndarray, sample: np.ndarray) -> list[np.ndarray]:
    """Runs of `RUN` evenly spaced source frame numbers, one from each sampled number on where there is one; each
    once."""
    step = int(np.diff(numbers).min()) if len(numbers) > 1 else 1
    found: dict[int, np.ndarray] = {}
    for start in np.searchsorted(numbers, sample):
        first = max(0, min(int(start), len(numbers) - RUN))
        run = numbers[first : first + RUN]
        if len(run) == RUN and int(run[-1] - run[0]) == step * (RUN - 1):
            found[first] = run
    return list(found.values())


def jitter_and_motion(runs: np.ndarray) -> tuple[float, float, int]:
    """(jitter px, motion px a frame, joints compared) of runs [R, 4, J, 3] (u, v, score); zeros where nothing can be
    compared.

    Jitter is the standard deviation of a coordinate's noise; motion the root mean square step of a joint without it.
    """
    joints = np.moveaxis(runs, 1, 2).reshape(-1, RUN, 3)
    joints = joints[(joints[..., 2] >= SCORE).all(axis=1)]
    if not len(joints):
        return 0.0, 0.0, 0
    x = joints[..., :2]
    third = x[:, 3] - 3 * x[:, 2] + 3 * x[:, 1] - x[:, 0]
    noise = float(np.median((third**2).sum(axis=-1))) / (20 * MEDIAN_CHI2)
    steps = np.sort((np.diff(x, axis=1) ** 2).sum(axis=-1).ravel())
    mean = float(steps[: max(1, int(TRIMMED * len(steps)))].mean())
    return float(np.sqrt(noise)), float(np.sqrt(max(0.0, mean - 4 * noise))), len(joints)
