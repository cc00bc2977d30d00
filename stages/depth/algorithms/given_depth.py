"""Depth maps that came with the capture, made fit to carry Gaussians: noise is smoothed, what straddles two surfaces
goes, edges are trusted less."""

from __future__ import annotations

import numpy as np

JUMP = 8.0
"""A step of more than this many pixel footprints z/f between neighbours is an edge between surfaces (a slope of 83
degrees)."""
EDGE = 0.5
"""Confidence of a pixel beside such an edge, where sensors and networks err."""


NOISY = 0.5
"""Noise from pixel to pixel, in pixel footprints, above which a map is smoothed: normals and sizes of Gaussians
follow from differences of neighbours."""
SPREAD, REACH = 3.0, 7
"""Of the smoothing: depths that count, in standard deviations of the noise, and its diameter in px."""


def given_depth(
    depth: np.ndarray, focal: float, depth_range: tuple[float, float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and confidence [h, w] float32 of one depth map [h, w] float32 m, 0 where there is none; `focal` px.

    Where depth is noisy from pixel to pixel it is smoothed within surfaces (bilaterally, in inverse depth). A pixel
    between two surfaces (nearer than its neighbour on one side and farther than that on the other, both by a jump)
    belongs to neither and goes, as does what lies outside `depth_range`. Confidence is 1, 1/2 beside an edge, and 0
    where there is no depth.
    """
    z = (
        depth
        if depth_range is None
        else np.where((depth >= depth_range[0]) & (depth <= depth_range[1]), depth, np.float32(0))
    )
    z = _smoothed(z, focal)
    flying = np.zeros(z.shape, bool)
    for axis in (0, 1):
        before, after = _steps(z, axis, focal)
        flying |= before * after > 0
    z = np.where(flying, np.float32(0), z)
    edge = np.zeros(z.shape, bool)
    for axis in (0, 1):
        before, after = _steps(z, axis, focal)
        edge |= (before != 0) | (after != 0)
    return z.astype(np.float32), np.where(z > 0, np.where(edge, EDGE, 1.0), 0.0).astype(np.float32)


def _smoothed(z: np.ndarray, focal: float) -> np.ndarray:
    """The same map where its noise is below NOISY; else the mean, in inverse depth, of those around that are within
    SPREAD of the noise."""
    import cv2

    inverse = np.where(z > 0, 1 / np.where(z > 0, z, 1), 0).astype(np.float32)
    noise = pixel_noise(inverse)
    footprint = float(np.median(inverse[inverse > 0])) / focal if inverse.any() else 0.0
    if noise <= NOISY * footprint:
        return z
    smooth = cv2.bilateralFilter(inverse, REACH, SPREAD * noise, REACH / 3)
    return np.where(z > 0, 1 / np.where(smooth > 0, smooth, 1), 0).astype(np.float32)


def pixel_noise(values: np.ndarray) -> float:
    """Standard deviation of what changes from pixel to pixel [h, w], from the median of second differences; 0 is no
    value, and edges do not count."""
    left, middle, right = values[:, :-2], values[:, 1:-1], values[:, 2:]
    known = (left > 0) & (middle > 0) & (right > 0)
    if not known.any():
        return 0.0
    # Gaussian noise: the median is 0.6745 deviations, and a second difference has six times the variance.
    return float(np.median(np.abs(left - 2 * middle + right)[known])) / 0.6745 / 6**0.5


def _steps(z: np.ndarray, axis: int, focal: float) -> tuple[np.ndarray, np.ndarray]:
    """[h, w] int8 twice: whether the depth jumps up (1) or down (-1) from the pixel before, and to the pixel after,
    along an axis; 0 beside no surface."""
    first, second = (np.take(z, np.arange(z.shape[axis])[part], axis) for part in (slice(None, -1), slice(1, None)))
    step = second - first
    jumps = (np.abs(step) > JUMP / focal * np.minimum(first, second)) & (first > 0) & (second > 0)
    signed = np.where(jumps, np.sign(step), 0).astype(np.int8)
    pad = [(0, 0), (0, 0)]
    before, after = list(pad), list(pad)
    before[axis], after[axis] = (1, 0), (0, 1)
    return np.pad(signed, before), np.pad(signed, after)
