"""Moving the outline of a mask by a constant distance."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.storage.model.masks import foreground


def moved(mask: np.ndarray, inwards: float) -> np.ndarray:
    """Mask [h, w] uint8 with its outline, where it crosses 127.5, moved inwards by so many px (outwards for a negative
    number), one px soft.

    What lies farther than that from the outline keeps its value.
    """
    inside = foreground(mask)
    if inwards == 0 or not inside.any() or inside.all():
        return mask
    # Distances to the outline from pixel centres, which lie half a pixel and more from it;
    # the soft value says how much.
    outside = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    within = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5)
    distance = np.where(inside, 0.5 - within, outside - 0.5)
    beside = np.abs(distance) <= 0.51
    distance = np.where(beside, np.float32(0.5) - mask / np.float32(255), distance)
    soft = np.clip(0.5 - (distance + np.float32(inwards)), 0, 1)
    near = np.abs(distance) <= abs(inwards) + 1
    return np.where(near, np.rint(255 * soft), mask).astype(np.uint8)
