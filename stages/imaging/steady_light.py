"""How much brighter a picture of a camera that stands still is than its background usually is, and the picture brought
back to that light.

Cameras that expose by themselves brighten and darken as somebody walks past. What is behind the subject has not
changed: most of its pixels agree on a factor, whatever covers the rest.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.imaging.color import gain_table, to_linear, to_srgb

UNTOLD = 99.0
"""Stops of a picture whose light its background does not tell."""
DARKEST, BRIGHTEST = 20, 235
"""sRGB values beyond which light is cut off, or all noise."""
CHANGES = 0.2
"""Stops in one channel from which on a camera's light counts as changing. `balance` and `desk`, whose cameras change by
up to 0.16, are drawn no better steadied (docs/measurements/exposure.md)."""
PIXELS = 2**16
"""Of a larger picture about so many, evenly spread, are looked at."""
AGREES, NOISE = 0.15, 4
"""Stops from the median, or steps of 255, within which a pixel shows the background: the rims of shadows and the
camera's curve are within the one, noise of what is dark within the other."""
FEWEST, MOST_OTHERS = 200, 0.6
"""Pixels, at least, that must tell; share of them, at most, that may show something else."""


def thinned(image: np.ndarray) -> np.ndarray:
    """Every n-th pixel of an image [h, w, ...], so that some `PIXELS` are left."""
    every = max(1, round((image.shape[0] * image.shape[1] / PIXELS) ** 0.5))
    return image[::every, ::every]


def stops_brighter(picture: np.ndarray, plate: np.ndarray, known: np.ndarray) -> np.ndarray:
    """[3] stops by which each channel of a picture [h, w, 3] is brighter than its camera's background plate [h, w, 3],
    both uint8 sRGB; `UNTOLD` where too few of the pixels that are `known` [h, w] bool to show background agree on it.
    """
    shown, ground, told = (thinned(a) for a in (picture, plate, known))
    middling = [((a >= DARKEST) & (a <= BRIGHTEST)).all(axis=2) for a in (shown, ground)]
    told = told & middling[0] & middling[1]
    if np.count_nonzero(told) < FEWEST:
        return np.full(3, UNTOLD)
    shown, ground = shown[told], ground[told]
    light = to_linear(np.arange(256))
    lit, usual = light[shown], light[ground]
    middle = np.median(np.log2(lit / usual), axis=0)
    expected = to_srgb(usual * 2.0**middle)
    agree = (np.abs(np.log2(lit / usual) - middle) < AGREES) | (np.abs(shown - expected) < NOISE)
    agree = agree.all(axis=1)
    if np.count_nonzero(agree) < max(FEWEST, (1 - MOST_OTHERS) * len(agree)):
        return np.full(3, UNTOLD)
    return np.log2(lit[agree].sum(axis=0) / usual[agree].sum(axis=0))


def steadied(picture: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """A picture [h, w, 3] uint8 sRGB without the `stops` [3] by which it is brighter than usual; as it is where these
    are `UNTOLD`."""
    import cv2

    if (stops >= UNTOLD).any():
        return picture
    return np.asarray(cv2.LUT(picture, gain_table(2.0**-stops)))
