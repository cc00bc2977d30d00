"""D-SSIM of a rendering and a picture, and its slope: half of what SSIM misses of one, pixel by pixel."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.imaging.part import part_around

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
"""Of SSIM, for values in 0..1 (Wang et al., 2004)."""
KERNEL = cv2.getGaussianKernel(WINDOW, SIGMA, cv2.CV_32F)
REACH, CHANNELS = WINDOW // 2, 3
EDGE = REACH * CHANNELS
"""Values beside a row, of pixels beyond the picture: all 0."""
W0, W1, W2, W3, W4, W5 = (np.float32(w) for w in KERNEL[REACH:, 0])
"""The window's weights from its middle out."""


class Moments(NamedTuple):
    """Of a picture around every pixel, under SSIM's window."""

    mean: np.ndarray  # [h, w, 3]
    square: np.ndarray  # [h, w, 3]
    """Mean of the squares."""

    @classmethod
    def of(cls, picture: np.ndarray) -> Moments:
        """Of a picture [h, w, 3] float32."""
        flat = np.ascontiguousarray(picture).reshape(len(picture), -1)
        return cls(*(_blurred(a).reshape(picture.shape) for a in (flat, flat * flat)))


def structure(
    x: np.ndarray, y: np.ndarray, moments: Moments, weight: np.ndarray, share: float
) -> tuple[float, np.ndarray]:
    """(sum over the pixels of share times weight [h, w] times the mean over channels of (1 - SSIM) / 2 of x and y
    [h, w, 3] float32, 0..1; its slope by x). `moments` are those of y; all are contiguous.

    Outside the picture all is 0, as published with 3DGS, so the window is its own adjoint. Rows are taken one after the
    other in two sweeps, the first up to what the windows miss, the second back from there, so that little of it leaves
    the processor's cache.
    """
    flat = x.shape[0], -1
    a, b, mean, square = (v.reshape(flat) for v in (x, y, *moments))
    missed, by_mean, by_square, by_product = _missed(a, b, mean, square, weight, np.float32(share / (2 * CHANNELS)))
    return missed, _gathered(by_mean, by_square, by_product, a, b).reshape(x.shape)


def around(wanted: np.ndarray) -> tuple[slice, slice]:
    """What is around the wanted pixels [h, w] bool as far as two windows reach: beyond it nothing differs where both
    pictures are black."""
    return part_around(wanted, WINDOW) if wanted.any() else (slice(0, 1), slice(0, 1))


@compiled
def _blurred(values):  # type: ignore[no-untyped-def]
    """Values [h, n] under the window, channels side by side."""
    out, row = np.empty_like(values), np.zeros(values.shape[1] + 2 * EDGE, np.float32)
    for i in range(values.shape[0]):
        _blur_row(values, i, row, out[i])
    return out


@compiled
def _blur_row(values, i, row, out):  # type: ignore[no-untyped-def]
    """Row `i` of values [h, n] under the window into `out` [n]. `row` [n + 2 EDGE] is lent, its edges are 0."""
    h, n = values.shape
    if REACH <= i < h - REACH:
        for j in range(n):
            row[EDGE + j] = (
                W0 * values[i, j]
                + W1 * (values[i - 1, j] + values[i + 1, j])
                + W2 * (values[i - 2, j] + values[i + 2, j])
                + W3 * (values[i - 3, j] + values[i + 3, j])
                + W4 * (values[i - 4, j] + values[i + 4, j])
                + W5 * (values[i - 5, j] + values[i + 5, j])
            )
    else:
        row[EDGE : EDGE + n] = W0 * values[i]
        for d, w in ((1, W1), (2, W2), (3, W3), (4, W4), (5, W5)):
            for k in (i - d, i + d):
                if 0 <= k < h:
                    row[EDGE : EDGE + n] += w * values[k]
    for j in range(n):
        m = EDGE + j
        out[j] = (
            W0 * row[m]
            + W1 * (row[m - 3] + row[m + 3])
            + W2 * (row[m - 6] + row[m + 6])
            + W3 * (row[m - 9] + row[m + 9])
            + W4 * (row[m - 12] + row[m + 12])
            + W5 * (row[m - 15] + row[m + 15])
        )


@compiled(error_model="numpy")
def _missed(x, y, my, myy, weight, share):  # type: ignore[no-untyped-def]
    """What is missed in all, and what it changes by with the window's mean, its squares and its products: all [h, n]
    float32, channels side by side, so that a processor takes many at a time; weight [h, n / 3]."""
    h, n = x.shape
    xx, xy = x * x, x * y
    by_mean, by_square, by_product = np.empty_like(x), np.empty_like(x), np.empty_like(x)
    row, mx, mxx, mxy = (
        np.zeros(n + 2 * EDGE, np.float32),
        np.empty_like(x[0]),
        np.empty_like(x[0]),
        np.empty_like(x[0]),
    )
    weights, missed = np.empty_like(mx), np.zeros(n, np.float64)
    c1, c2, one, two = np.float32(C1), np.float32(C2), np.float32(1), np.float32(2)
    for i in range(h):
        _blur_row(x, i, row, mx)
        _blur_row(xx, i, row, mxx)
        _blur_row(xy, i, row, mxy)
        for j in range(n // CHANNELS):
            for c in range(CHANNELS):
                weights[CHANNELS * j + c] = share * weight[i, j]
        for j in range(n):
            s, a, b = weights[j], mx[j], my[i, j]
            a1, b1 = two * a * b + c1, a * a + b * b + c1
            a2 = two * (mxy[j] - a * b) + c2
            b2 = (mxx[j] - a * a) + (myy[i, j] - b * b) + c2
            bottom = one / (b1 * b2)
            ssim = a1 * a2 * bottom
            square, product = -s * ssim / b2, s * two * a1 * bottom
            missed[j] += s * (one - ssim)
            by_square[i, j], by_product[i, j] = square, product
            mean = s * (two * b * a2 * bottom - two * a * ssim / b1)
            by_mean[i, j] = mean - two * a * square - b * product
    return missed.sum(), by_mean, by_square, by_product


@compiled
def _gathered(by_mean, by_square, by_product, x, y):  # type: ignore[no-untyped-def]
    """The slope [h, n] by every pixel, of the windows it lies in."""
    slope, (h, n) = np.empty_like(x), x.shape
    row, mean, square, product = (
        np.zeros(n + 2 * EDGE, np.float32),
        np.empty_like(x[0]),
        np.empty_like(x[0]),
        np.empty_like(x[0]),
    )
    for i in range(h):
        _blur_row(by_mean, i, row, mean)
        _blur_row(by_square, i, row, square)
        _blur_row(by_product, i, row, product)
        for j in range(n):
            slope[i, j] = -(mean[j] + np.float32(2) * x[i, j] * square[j] + y[i, j] * product[j])
    return slope
