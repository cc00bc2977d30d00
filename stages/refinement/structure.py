"""D-SSIM of a rendering and a picture, and its slope: half of what SSIM misses of one, pixel by pixel."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
"""Of SSIM, for values in 0..1 (Wang et al., 2004)."""
_KERNEL = cv2.getGaussianKernel(WINDOW, SIGMA, cv2.CV_32F)


class Moments(NamedTuple):
    """Of a picture around every pixel, under SSIM's window."""

    mean: np.ndarray  # [h, w, 3]
    square: np.ndarray  # [h, w, 3]
    """Mean of the squares."""

    @classmethod
    def of(cls, picture: np.ndarray) -> Moments:
        """Of a picture [h, w, 3] float32."""
        return cls(_blur(picture), _blur(picture * picture))


def structure(
    x: np.ndarray, y: np.ndarray, moments: Moments, weight: np.ndarray, share: float
) -> tuple[float, np.ndarray]:
    """(sum over the pixels of share times weight [h, w] times the mean over channels of (1 - SSIM) / 2 of x and y
    [h, w, 3] float32, 0..1; its slope by x). `moments` are those of y.

    Outside the picture all is 0, as published with 3DGS, so the window is its own adjoint. OpenCV filters row by row,
    and sums have a fixed order: the result does not depend on threads.
    """
    value, by_mean, by_square, by_product = _slopes(
        _blur(x), _blur(cv2.multiply(x, x)), _blur(cv2.multiply(x, y)), *moments, weight, np.float32(share / 6)
    )
    slope = _gathered(_blur(by_mean), _blur(by_square), _blur(by_product), x, y)
    return value, slope


def around(wanted: np.ndarray) -> tuple[slice, slice]:
    """What is around the wanted pixels [h, w] bool as far as two windows reach: beyond it nothing differs where both
    pictures are black."""
    found = [np.flatnonzero(wanted.any(axis=axis)) for axis in (1, 0)]
    rows, columns = (
        slice(max(int(f[0]) - WINDOW, 0), int(f[-1]) + WINDOW + 1) if len(f) else slice(0, 1) for f in found
    )
    return rows, columns


def _blur(values: np.ndarray) -> np.ndarray:
    blurred: np.ndarray = cv2.sepFilter2D(values, -1, _KERNEL, _KERNEL, borderType=cv2.BORDER_CONSTANT)
    return blurred


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(mx, mxx, mxy, my, myy, weight, share):  # type: ignore[no-untyped-def]
    """The value, and what it changes by a change of the window's mean, of its squares and of its products."""
    h, w, channels = mx.shape
    by_mean, by_square, by_product = np.empty_like(mx), np.empty_like(mx), np.empty_like(mx)
    c1, c2, one, two = np.float32(C1), np.float32(C2), np.float32(1), np.float32(2)
    value = 0.0
    for i in range(h):
        row = np.float32(0)
        for j in range(w):
            s = share * weight[i, j]
            for c in range(channels):
                a, b = mx[i, j, c], my[i, j, c]
                a1, b1 = two * a * b + c1, a * a + b * b + c1
                a2 = two * (mxy[i, j, c] - a * b) + c2
                b2 = (mxx[i, j, c] - a * a) + (myy[i, j, c] - b * b) + c2
                bottom = one / (b1 * b2)
                ssim = a1 * a2 * bottom
                square, product = -s * ssim / b2, s * two * a1 * bottom
                row += s * (one - ssim)
                by_square[i, j, c], by_product[i, j, c] = square, product
                mean = s * (two * b * a2 * bottom - two * a * ssim / b1)
                by_mean[i, j, c] = mean - two * a * square - b * product
        value += row
    return value, by_mean, by_square, by_product


@njit(cache=True, nogil=True)
def _gathered(by_mean, by_square, by_product, x, y):  # type: ignore[no-untyped-def]
    """The slope by every pixel, of the windows it lies in."""
    slope = np.empty_like(by_mean)
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            for c in range(x.shape[2]):
                along = np.float32(2) * x[i, j, c] * by_square[i, j, c] + y[i, j, c] * by_product[i, j, c]
                slope[i, j, c] = -(by_mean[i, j, c] + along)
    return slope
