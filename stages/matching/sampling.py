"""Looking up depth maps with holes: between pixels, across a picture, and from one view in another."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.compiling.compiled import compiled


@compiled
def sample(values: np.ndarray, xs: np.ndarray, ys: np.ndarray, jump: float) -> np.ndarray:
    """Bilinear look-up of values [h, w] float32 at integer-centre positions [n, m], float32; 0 means unknown, in and
    out.

    Unknown neighbours drop out of the weights; neighbours that differ by more than the share `jump` belong to
    different surfaces, and the nearest is taken as it is.
    """
    height, width = values.shape
    out = np.zeros(xs.shape, np.float32)
    for i in range(xs.shape[0]):
        for j in range(xs.shape[1]):
            x, y = xs[i, j], ys[i, j]
            if not (x > -1 and y > -1 and x < width and y < height):
                continue
            column, row = int(np.floor(x)), int(np.floor(y))
            a, b = x - column, y - row
            total, weights, low, high, nearest, heaviest = 0.0, 0.0, np.inf, -np.inf, 0.0, 0.0
            for k in range(4):
                c, r = column + (k & 1), row + (k >> 1)
                if c < 0 or r < 0 or c >= width or r >= height or values[r, c] == 0:
                    continue
                value = values[r, c]
                weight = (a if k & 1 else 1 - a) * (b if k >> 1 else 1 - b)
                total += weight * value
                weights += weight
                low, high = min(low, value), max(high, value)
                if weight > heaviest:
                    heaviest, nearest = weight, value
            if weights > 0:
                out[i, j] = total / weights if high - low <= jump * abs(nearest) else nearest
    return out


def extend(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Values [h, w, ...] with every unknown pixel replaced by its nearest known one;
    unchanged where nothing is known."""
    import cv2

    if known.all() or not known.any():
        return values
    _, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    where = np.flatnonzero(known)
    pixel = np.zeros(labels.max() + 1, np.int64)
    pixel[labels.ravel()[where]] = where
    return values.reshape(-1, *values.shape[2:])[pixel[labels]]


def beyond_silhouette(color: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The picture with the nearest foreground colour in place of the background, so that windows see no false edge.

    The outermost pixel of the foreground is replaced too: it is mixed with the background.
    """
    import cv2

    return extend(color, cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


@compiled
def disagreement(depth: np.ndarray, other: np.ndarray, transfer: np.ndarray, focal_baseline: float) -> np.ndarray:
    """Px of disparity by which the depth map `other` of a second view contradicts `depth` [h, w]; infinite without a
    match.

    `transfer` [3, 4] takes (x z, y z, z, 1) of the first view to homogeneous pixels of the second, both integer
    centres. The best of the 3x3 pixels around the point's picture counts, so that a slanted surface does not contradict
    itself.
    """
    height, width = depth.shape
    out = np.full((height, width), np.inf, np.float32)
    for i in range(height):
        for j in range(width):
            z = depth[i, j]
            if z <= 0:
                continue
            x = z * (transfer[0, 0] * j + transfer[0, 1] * i + transfer[0, 2]) + transfer[0, 3]
            y = z * (transfer[1, 0] * j + transfer[1, 1] * i + transfer[1, 2]) + transfer[1, 3]
            w = z * (transfer[2, 0] * j + transfer[2, 1] * i + transfer[2, 2]) + transfer[2, 3]
            if w <= 1e-6 or not (abs(x) < 1e6 * w and abs(y) < 1e6 * w):
                continue
            column, row = int(np.rint(x / w)), int(np.rint(y / w))
            for r in range(max(row - 1, 0), min(row + 2, other.shape[0])):
                for c in range(max(column - 1, 0), min(column + 2, other.shape[1])):
                    if other[r, c] > 0:
                        out[i, j] = min(out[i, j], focal_baseline * abs(1 / other[r, c] - 1 / w))
    return out


@compiled
def _look(inverse: np.ndarray, mask: np.ndarray, i: int, j: int, di: int, dj: int) -> tuple[float, int]:
    """The first known value in a direction and its distance, without leaving the mask; (0, 1) where there is none."""
    steps = 1
    r, c = i + di, j + dj
    while 0 <= r < inverse.shape[0] and 0 <= c < inverse.shape[1] and mask[r, c]:
        if inverse[r, c] > 0:
            return inverse[r, c], steps
        r, c, steps = r + di, c + dj, steps + 1
    return 0.0, 1


@compiled
def fill(inverse: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Inverse depth [h, w] with the gaps of the mask filled from the nearest known pixels left, right, above and below.

    A gap is what one of two pictures could not see, so it belongs to the farther surface: the farthest neighbour
    counts, and those within 5 % of it, weighted by distance. 0 remains where no neighbour inside the mask is known.
    """
    out = inverse.copy()
    for i in range(inverse.shape[0]):
        for j in range(inverse.shape[1]):
            if not mask[i, j] or inverse[i, j] > 0:
                continue
            found = (
                _look(inverse, mask, i, j, 0, -1),
                _look(inverse, mask, i, j, 0, 1),
                _look(inverse, mask, i, j, -1, 0),
                _look(inverse, mask, i, j, 1, 0),
            )
            farthest = np.inf
            for value, _ in found:
                if 0 < value < farthest:
                    farthest = value
            total, weights = 0.0, 0.0
            for value, steps in found:
                if 0 < value <= 1.05 * farthest:
                    total += value / steps
                    weights += 1 / steps
            if weights > 0:
                out[i, j] = total / weights
    return out
