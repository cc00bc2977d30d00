"""Foreground of a static camera from a plate of its background."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

DARKEST_SHADOW = 0.6
"""A shadow keeps at least this share of the plate's sRGB value: a third of the linear light."""
SPREAD_GAIN = 2.0
UNSEEN = 250
"""Spread from which on the plate shows no background; a pixel averaged with seen neighbours is seen."""
SMALLEST_PART = 0.02
"""Share of the foreground below which a part is no limb and a hole is no gap between limbs."""


def plate_matte(
    picture: np.ndarray,
    plate: np.ndarray,
    spread: np.ndarray,
    threshold: float,
    least: float = 0.0,
    taken_out: Callable[[np.ndarray], np.ndarray] = np.asarray,
) -> np.ndarray:
    """Soft foreground [h, w] uint8 of one frame.

    picture, plate [h, w, 3] uint8 sRGB; spread [h, w] uint8, the plate's median absolute deviation; threshold in 1/255;
    parts that cover less than `least` px are nobody's; `taken_out`: a foreground [h, w] uint8 0 or 1 without what is
    somebody else's.
    A pixel is foreground when its `plate_distance` exceeds the threshold, raised by twice the spread (at most doubled),
    or half of it in contact with such pixels (Canny's hysteresis). A pixel whose background was never seen (spread 255)
    counts as half the threshold: a person nearly always stands there. What cannot be told: clothes that match the
    plate, or a smooth darker shade of it, are background.
    """
    limit = threshold + np.minimum(SPREAD_GAIN * spread.astype(np.float32), threshold)
    distance = plate_distance(picture, plate, threshold)
    relative = distance / limit
    unseen = spread >= UNSEEN
    strong = cv2.morphologyEx((relative > 1.0).astype(np.uint8), cv2.MORPH_OPEN, _disc(1))
    mask = _connected(strong, ((relative > 0.5) | unseen).astype(np.uint8))
    mask = taken_out(mask)
    return _soft_edge(_clean(mask, least), np.where(unseen, limit, distance))


def plate_distance(picture: np.ndarray, plate: np.ndarray, threshold: float) -> np.ndarray:
    """Colour distance [h, w] float32, 1/255, of a picture from its plate and from every shadow on the plate.

    The distance is taken to the segment [0.6 B, B] of the plate's colour B: a shadow scales B and keeps its
    chromaticity (Horprasert, Harwood and Davis 1999). A true shadow also keeps the plate's texture; where a pixel on
    the segment is darker than the threshold and the picture around it is no smooth multiple of the plate, it is not a
    shadow.
    """
    image, back = (
        cv2.GaussianBlur(picture, (0, 0), 0.7).astype(np.float32),
        cv2.GaussianBlur(plate, (0, 0), 0.7).astype(np.float32),
    )
    scale = np.sum(image * back, axis=2) / np.maximum(np.sum(back * back, axis=2), 1.0)
    residual = image - np.clip(scale, DARKEST_SHADOW, 1.0)[..., None] * back
    distance = np.linalg.norm(residual, axis=2)
    plain = np.linalg.norm(image - back, axis=2)
    texture = np.where(plain > threshold, np.minimum(2.0 * _texture_change(image, back), plain), 0.0)
    return np.maximum(distance, texture).astype(np.float32)


def _texture_change(image: np.ndarray, back: np.ndarray) -> np.ndarray:
    side = max(3, round(max(image.shape[:2]) / 64)) | 1
    grey, ground = image.sum(axis=2) / np.float32(np.sqrt(3.0)), back.sum(axis=2) / np.float32(np.sqrt(3.0))

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.blur(values, (side, side))

    # What a ramp cannot explain of the ratio to the plate: a soft shadow's edge cancels, cloth does not.
    ratio = grey / np.maximum(ground, 16.0)
    return ground * np.sqrt(np.maximum(mean(np.square(ratio - mean(ratio))), 0))  # running sums can end just below 0


def _soft_edge(mask: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Coverage [h, w] uint8: in a band along the edge, how much of the distance that the inside nearby has is reached.

    A pixel that is covered by a half has half the distance, which a threshold far below the contrast takes as whole.
    """
    radius = max(1, round(max(mask.shape) / 128))
    inside = cv2.erode(mask, _disc(radius), borderValue=1)
    contrast = cv2.dilate(np.where(mask > 0, distance, np.float32(0.0)), _disc(radius))
    share = np.clip(2.0 * distance / np.maximum(contrast, 1.0) - 0.5, 0.0, 1.0)
    alpha = np.where(inside > 0, np.float32(1.0), share * mask).astype(np.float32)
    return np.rint(255.0 * cv2.GaussianBlur(alpha, (0, 0), 0.5)).astype(np.uint8)


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _connected(strong: np.ndarray, weak: np.ndarray) -> np.ndarray:
    count, labels = cv2.connectedComponents(weak | strong, connectivity=8)
    kept = np.zeros(count, dtype=np.uint8)
    kept[np.unique(labels[strong > 0])] = 1
    kept[0] = 0
    return kept[labels]


def _clean(mask: np.ndarray, least: float) -> np.ndarray:
    """Close cracks and small holes, drop speckles and what covers less than `least` px, keep the main part and what
    lies near it. [h, w] uint8 0 or 1."""
    longest = max(mask.shape)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _disc(max(1, round(longest / 100))))
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _disc(max(1, round(longest / 400))))
    mask = _fill_holes(mask, max(0.0005 * mask.size, SMALLEST_PART * float(mask.sum())))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.float64)
    areas[0] = 0.0
    if count < 2:
        return mask
    main = int(np.argmax(areas))
    near = cv2.distanceTransform((labels != main).astype(np.uint8), cv2.DIST_L2, 5) <= 0.05 * longest
    kept = np.zeros(count, dtype=np.uint8)
    kept[np.unique(labels[near])] = 1
    kept[areas < max(SMALLEST_PART * areas[main], least)] = 0
    return kept[labels]


def _fill_holes(mask: np.ndarray, largest: float) -> np.ndarray:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(1 - mask, connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] <= largest
    small[0] = False
    return np.where(small[labels], np.uint8(1), mask) if count > 1 else mask
