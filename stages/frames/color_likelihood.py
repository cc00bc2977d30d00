"""Foreground or background, pixel by pixel: log odds from colours seen nearby and from the background plate."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.frames.plate_matte import UNSEEN, plate_distance

SPREAD = 8.0
"""1/255 by which a background's colour differs from its plate, beside the plate's own spread:
noise, compression, faint shadows."""
SPREAD_GAIN = 1.5
COLOR_FLOOR = 60.0
"""(1/255)² added to the variance of colours nearby: never surer than noise allows."""
ANYTHING = -3 * np.log(60.0)
"""Log density, up to the constant of a Gaussian, of a colour that nothing is known of."""
SURPRISE = 1.5
"""Log odds against a colour unlike all those nearby: a highlight, a marker, a stripe."""
MOST = 4.0
"""Log odds that one pixel's colour may give."""
UNPLATED = 0.3
"""Weight of a colour's odds where only the colours around tell what the background is,
beside 1 where the plate does."""
CHANGED = 0.3
"""Share of the background that differs from its plate from which on the plate says nothing:
the camera moved or the light changed."""


class Plate:
    """A background plate against one picture: log density of every pixel's colour, were it background."""

    def __init__(
        self,
        picture: np.ndarray,
        plate: np.ndarray,
        spread: np.ndarray,
        threshold: float,
        outside: np.ndarray,
        shadow: np.ndarray,
    ) -> None:
        """picture, plate [h, w, 3] uint8; spread [h, w] uint8; outside [h, w] bool: surely background, by which the
        plate is judged; shadow [h, w] float32: log density of its colour, were it ground in a shadow."""
        distance = plate_distance(picture, plate, threshold)
        width = SPREAD + SPREAD_GAIN * spread.astype(np.float32)
        self.known = spread < UNSEEN
        """[h, w] bool: where the background was seen."""
        seen = _or_anything(-0.5 * np.square(distance / width) - 3 * np.log(width), 2.0)
        self.density = np.logaddexp(seen, shadow)
        """[h, w] float32, up to the constant of a Gaussian."""
        judged = outside & self.known
        changed = float((distance[judged] > threshold + SPREAD_GAIN * spread[judged]).mean()) if judged.any() else 0.0
        self.trust = max(0.0, 1.0 - changed / CHANGED)
        """0..1."""


def color_odds(picture: np.ndarray, inside: np.ndarray, side: int, plate: Plate | None) -> np.ndarray:
    """[h, w] float32 log odds that a pixel is foreground by its colour alone, at most `MOST` either way.

    picture [h, w, 3] float32; inside [h, w] float32 0..1, what is believed so far: the colours of foreground and
    background are Gaussians over windows of `side` px, weighted by its square and by that of the rest. Where the plate
    shows the background, that is what the foreground's colours are compared with.
    """
    fore = _or_anything(_near(picture, np.square(inside), side), SURPRISE)
    back = _or_anything(_near(picture, np.square(1 - inside), side), SURPRISE)
    odds = UNPLATED * np.clip(fore - back, -MOST, MOST)
    if plate is not None:
        plated = np.clip(fore - plate.density, -MOST, MOST)
        odds = np.where(plate.known, plate.trust * plated + (1 - plate.trust) * odds, odds)
    return odds.astype(np.float32)


def _or_anything(density: np.ndarray, surprise: float) -> np.ndarray:
    return np.logaddexp(density, np.float32(ANYTHING - surprise)).astype(np.float32)


def _near(picture: np.ndarray, weight: np.ndarray, side: int) -> np.ndarray:
    """[h, w] float32 log density of each pixel's colour under the weighted Gaussian of its window;
    `ANYTHING` where nothing weighs."""

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.blur(values, (side, side))

    total = mean(weight) + np.float32(1e-4)
    middle = [mean(weight * picture[..., i]) / total for i in range(3)]
    xx, yy, zz, xy, xz, yz = (
        mean(weight * picture[..., i] * picture[..., j]) / total
        - middle[i] * middle[j]
        + (np.float32(COLOR_FLOOR) if i == j else np.float32(0))
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    )
    x, y, z = (picture[..., i] - middle[i] for i in range(3))
    # Inverse of a symmetric 3x3 by its cofactors;
    # running sums can leave a variance a hair below 0, hence the floor again.
    a, b, c = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    determinant = np.maximum(xx * a - xy * (xy * zz - xz * yz) + xz * (xy * yz - xz * yy), np.float32(COLOR_FLOOR**3))
    square = (
        x * x * a
        + y * y * b
        + z * z * c
        + 2 * (x * y * (xz * yz - xy * zz) + x * z * (xy * yz - xz * yy) + y * z * (xy * xz - xx * yz))
    )
    density = -0.5 * (np.maximum(square, 0) / determinant + np.log(determinant))
    return np.where(total > 0.01, density, np.float32(ANYTHING)).astype(np.float32)
