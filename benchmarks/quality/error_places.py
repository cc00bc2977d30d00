"""Where in a picture the squared error lies: outside the silhouette, on its rim, in holes, inside."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.storage.model.masks import foreground

PLACES = ("outside", "rim", "holes", "inside")
RIM = 1.5
"""Px to both sides of the true outline that count as its rim: the pixels that touch it."""
HOLE = 0.5
"""Coverage below which a rendered pixel inside the silhouette is a hole."""


def squared_error_by_place(rendered: np.ndarray, alpha: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """[4] sums of squared error, 1/255 squared, over the PLACES; their sum is that of the picture.

    Args:
        rendered: [h, w, 3] uint8, premultiplied on black.
        alpha: [h, w] uint8 coverage of the rendered picture.
        truth: [h, w, 3] uint8 as filmed.
        mask: [h, w] uint8, covered share of the pixel.
    """
    reference = truth.astype(np.float64) * (mask[..., None] / 255.0)
    error = ((rendered.astype(np.float64) - reference) ** 2).sum(axis=2)
    inside = foreground(mask)
    apart = np.maximum(
        cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5),
        cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5),
    )
    rim = apart <= RIM
    hole = inside & ~rim & (alpha < HOLE * 255)
    return np.array([error[place].sum() for place in (~inside & ~rim, rim, hole, inside & ~rim & ~hole)])
