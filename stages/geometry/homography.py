"""Pixels through a homography, compiled."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.compiling.compiled import compiled


@compiled(error_model="numpy")
def applied(homography: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a homography [3, 3] takes pixels [N, 2], and the value of its third row [N]; dividing by 0 gives what is
    not finite."""
    h, image, ratio = homography, np.empty_like(pixels), np.empty(len(pixels))
    for n in range(len(pixels)):
        x, y = pixels[n]
        w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        image[n, 0] = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
        image[n, 1] = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
        ratio[n] = w
    return image, ratio
