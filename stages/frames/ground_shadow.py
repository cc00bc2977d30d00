"""The shadow under a person's feet: the ground there looks like its plate, as much darker in all channels as around it.

Under a sole the ground keeps less of its light than `posegaussian.stages.frames.plate_matte` allows a shadow, and an
estimator's segmentation counts it to the foot. So does a dark sole look, but a shadow goes on where nobody counts it to
the person, and a sole ends there.
"""

from __future__ import annotations

import cv2
import numpy as np

DEEPEST, FAINTEST = 0.35, 0.9
"""Share of the plate's sRGB value that a shadow keeps, at least, a tenth of the linear light, and at most."""
SPREAD, SPREAD_GAIN = 6.0, 0.5
"""1/255 by which ground in a shadow differs from its plate as dark as around it, and what the plate's own spread adds.
With 4 or 8 as many pixels are wrong, but for .05 % of the masks."""
ALIKE = 2.0
"""Standard deviations within which a colour is that of a shadow."""
OUTSIDE, BEYOND = -1.0, 0.4
"""Log odds of the subject below which a pixel counts to nobody, and share of a shadow that must. Of a person in the
simulator's room, whose floor has no shadows, 0.6 % of the masks are lost, most of it soles, where a single pixel must,
0.12 % with 0.2 and 0.003 % with 0.4; of shadows under two other people 0.05 % of the masks more stay in."""


def shadow_density(
    picture: np.ndarray, plate: np.ndarray, spread: np.ndarray, grounded: np.ndarray, prior: np.ndarray
) -> np.ndarray:
    """[h, w] float32 log density, up to the constant of a Gaussian, of every pixel's colour, were it ground in a
    shadow; minus infinity where there is none.

    Args:
        picture: [h, w, 3] uint8 sRGB.
        plate: [h, w, 3] uint8 sRGB, the background.
        spread: [h, w] uint8, the plate's.
        grounded: [h, w] bool, where feet may touch the ground.
        prior: [h, w] float32, log odds of the subject before the picture was looked at.
    """
    shown, ground = (cv2.GaussianBlur(a, (0, 0), 0.7).astype(np.float32) for a in (picture, plate))
    own = (shown * ground).sum(axis=2) / np.maximum((ground * ground).sum(axis=2), 1.0)
    share = np.clip(cv2.medianBlur(own, 5), DEEPEST, 1.0)
    width = SPREAD + SPREAD_GAIN * spread.astype(np.float32)
    distance = np.linalg.norm(shown - share[..., None] * ground, axis=2) / width
    shadow = _going_on(grounded & (share < FAINTEST) & (distance < ALIKE), prior < OUTSIDE)
    return np.where(shadow, -0.5 * np.square(distance) - 3 * np.log(width), -np.inf).astype(np.float32)


def _going_on(shadow: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """[h, w] bool: the parts of a shadow [h, w] bool that lie outside the subject, [h, w] bool, by `BEYOND`."""
    count, labels = cv2.connectedComponents(shadow.astype(np.uint8), connectivity=4)
    area, beyond = (np.bincount(labels[a].ravel(), minlength=count) for a in (shadow, shadow & outside))
    kept = beyond > BEYOND * area
    kept[0] = False
    return np.asarray(kept[labels])
