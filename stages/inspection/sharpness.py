"""How sharp a camera's pictures are, from the width of their strongest edges.

An edge blurred by s has its steepest slope lowered by sqrt(s^2 + b^2) / s when the picture is blurred by b once more;
the ratio of the slopes before and after gives s (Zhuo and Sim, "Defocus map estimation from a single image", 2011). It
does not depend on the edge's contrast, nor on how much texture there is, as the variance of a Laplacian would.
"""

from __future__ import annotations

import cv2
import numpy as np

FINE, COARSE = 1.0, 2.0
"""Px of the two blurs that are compared; the finer one keeps noise from looking like edges."""
DIFFERENCE = 1 / 3
"""Px^2 by which taking the difference of a pixel's two neighbours blurs once more: the variance of a box of 2 px."""
STRONGEST = 0.9
"""Quantile of the slopes of edges from which on they count."""
FEWEST = 50
"""Edge pixels without which nothing is said."""
TYPICAL = 75
"""Percentile over those edges: thin lines, pixelated faces and what compression leaves look sharper than any lens."""


def edge_width(picture: np.ndarray, region: tuple[int, int, int, int] | None = None) -> float | None:
    """Standard deviation in px of the blur of a picture's strong edges, [h, w, 3] uint8; None without enough edges.

    region: x0, y0, x1, y1 in px of what is looked at; None: everything. Optics, motion, compression and enlargement all
    count.
    """
    gray = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    if region is not None:
        x0, y0, x1, y1 = region
        gray = gray[max(0, y0) : y1, max(0, x0) : x1]
    if min(gray.shape, default=0) < 16:
        return None
    (fine, along), (coarse, _) = _slopes(gray, FINE), _slopes(gray, COARSE)
    edge = _ridge(fine, along)
    edge[:6], edge[-6:], edge[:, :6], edge[:, -6:] = False, False, False, False
    if edge.sum() < FEWEST:
        return None
    strong = edge & (fine >= np.quantile(fine[edge], STRONGEST)) & (coarse > 1e-3)
    if strong.sum() < FEWEST:
        strong = edge & (fine >= np.sort(fine[edge])[-FEWEST]) & (coarse > 1e-3)
    ratio2 = (fine[strong] / coarse[strong]) ** 2
    fine2, coarse2 = FINE**2 + DIFFERENCE, COARSE**2 + DIFFERENCE
    ratio2 = np.clip(ratio2, 1.001, coarse2 / fine2)
    return float(np.sqrt(np.percentile((coarse2 - ratio2 * fine2) / (ratio2 - 1), TYPICAL)))


def _slopes(gray: np.ndarray, blur: float) -> tuple[np.ndarray, np.ndarray]:
    """Steepness [h, w] of a picture blurred by `blur` px, and its direction as one of 4, 45 degrees apart."""
    soft = cv2.GaussianBlur(gray, (0, 0), blur)
    dx, dy = (
        cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8),
        cv2.Sobel(soft, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8),
    )
    return np.hypot(dx, dy), np.rint(np.arctan2(dy, dx) / (np.pi / 4)).astype(int) % 4


def _ridge(slope: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """[h, w] bool: where the slope is the largest of its neighbours along its own direction."""
    out = np.zeros(slope.shape, bool)
    padded = np.pad(slope, 1)
    h, w = slope.shape
    for k, (dx, dy) in enumerate(((1, 0), (1, 1), (0, 1), (-1, 1))):
        ahead, behind = (
            padded[1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w],
            padded[1 - dy : 1 - dy + h, 1 - dx : 1 - dx + w],
        )
        out |= (direction == k) & (slope > ahead) & (slope >= behind)
    return out
