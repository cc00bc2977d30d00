"""How noisy a camera's pictures are: each of them, and from one to the next where nothing moves."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from posegaussian.stages.imaging.noise import OCTAVES

DARKEST, BRIGHTEST = 8, 247
"""sRGB values beyond which noise is cut off."""
LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Zero on planes; of noise of standard deviation s it makes one of 6 s (Immerkaer, "Fast noise variance estimation",
1996)."""
PIXELS = 2**18
"""Of larger pictures, strips of about so many pixels in all are looked at: their median is within a hundredth of the
whole's."""
STRIP = 16
"""Rows of a strip."""
LIT = 2**16
"""Pixels, at most, that tell how much brighter one picture is than another."""
QUIET, OF_QUIET = 0.25, 0.404
"""Share of the pixels that surely stand still, and what it is of the variance: the quantile of a mean of three squared
normal differences."""


def at_octaves(measure: Callable[..., float], *pictures: np.ndarray) -> np.ndarray:
    """[OCTAVES] what `measure` says of pictures [h, w, 3] uint8 of one size: as they are, and made a half, a quarter
    and an eighth as large by averaging pixels, as smaller pictures are made to work on. Below 3 px what it said last.
    """
    found: list[float] = []
    for octave in range(OCTAVES):
        size = tuple(n >> octave for n in pictures[0].shape[1::-1])
        if min(size) < 3 and found:
            found.append(found[-1])
            continue
        shrunk = [p if octave == 0 else cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in pictures]
        found.append(measure(*shrunk))
    return np.array(found)


def noise_level(picture: np.ndarray) -> float:
    """Standard deviation of a picture's noise, 1/255 sRGB, mean of the channels; [h, w, 3] uint8.

    The median of the Laplacian's deviation instead of Immerkaer's mean, so that edges do not count, over pixels that
    are neither nearly black nor nearly white, where noise is cut off; 0 where there are none. Fine texture counts as
    noise.
    """
    one_in = -(-picture.shape[0] * picture.shape[1] // PIXELS)
    strips = (
        [picture[y : y + STRIP] for y in range(0, picture.shape[0] - 2, STRIP * one_in)] if one_in > 1 else [picture]
    )
    found = np.concatenate([_responses(s) for s in strips])
    return float(np.median(found, axis=0).mean() / (6 * 0.6745)) if len(found) else 0.0


def _responses(strip: np.ndarray) -> np.ndarray:
    """[n, 3] size of the Laplacian at the pixels of a strip [h, w, 3] that are middling, its border left out."""
    inner = strip[1:-1, 1:-1]
    middling = ((inner >= DARKEST) & (inner <= BRIGHTEST)).all(axis=2)
    return np.abs(cv2.filter2D(strip.astype(np.float32), -1, LAPLACIAN))[1:-1, 1:-1][middling]


def unrest(before: np.ndarray, after: np.ndarray) -> float:
    """Standard deviation of the noise of two pictures [h, w, 3] uint8 of one camera that follow each other, 1/255 sRGB.

    From the quarter of the pixels that changed least, of those that are neither nearly black nor nearly white, where
    noise is cut off; 0 where there are none. Too large where more than half of the picture moves. Light that changes
    all over the picture is no noise.
    """
    middling = ((before >= DARKEST) & (before <= BRIGHTEST) & (after >= DARKEST) & (after <= BRIGHTEST)).all(axis=2)
    if not middling.any():
        return 0.0
    first, second = before[middling].astype(np.float32), after[middling].astype(np.float32)
    every = -(-len(first) // LIT)
    brighter = np.median(second[::every] / first[::every], axis=0)
    apart = ((first - second / brighter) ** 2).mean(axis=1)
    return float(np.sqrt(np.quantile(apart, QUIET) / (2 * OF_QUIET)))
