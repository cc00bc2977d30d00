"""D-SSIM of a rendering and a picture, and its slope: half of what SSIM misses of one, pixel by pixel."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit

from posegaussian.stages.imaging.part import part_around

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
"""Of SSIM, for values in 0..1 (Wang et al., 2004)."""
KERNEL = cv2.getGaussianKernel(WINDOW, SIGMA, cv2.CV_32F)


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
    flat = x.shape[0], x.shape[1] * x.shape[2]
    weights = np.repeat(np.float32(share / 6) * weight, x.shape[2], axis=1)
    mx, mxx, mxy = (_blur(v).reshape(flat) for v in (x, cv2.multiply(x, x), cv2.multiply(x, y)))
    my, myy = (m.reshape(flat) for m in moments)
    missed, *slopes = _slopes(mx, mxx, mxy, my, myy, weights)
    by_mean, by_square, by_product = (_blur(s.reshape(x.shape)).reshape(flat) for s in slopes)
    slope = _gathered(by_mean, by_square, by_product, x.reshape(flat), y.reshape(flat)).reshape(x.shape)
    return float(missed.sum(dtype=np.float64)), slope


def around(wanted: np.ndarray) -> tuple[slice, slice]:
    """What is around the wanted pixels [h, w] bool as far as two windows reach: beyond it nothing differs where both
    pictures are black."""
    return part_around(wanted, WINDOW) if wanted.any() else (slice(0, 1), slice(0, 1))


def _blur(values: np.ndarray) -> np.ndarray:
    blurred: np.ndarray = cv2.sepFilter2D(values, -1, KERNEL, KERNEL, borderType=cv2.BORDER_CONSTANT)
    return blurred


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(mx, mxx, mxy, my, myy, weight):  # type: ignore[no-untyped-def]
    """What is missed, and what it changes by with the window's mean, its squares and its products: all [h, n] float32,
    channels side by side, so that a processor takes many at a time."""
    missed, by_mean, by_square, by_product = (
        np.empty_like(mx),
        np.empty_like(mx),
        np.empty_like(mx),
        np.empty_like(mx),
    )
    c1, c2, one, two = np.float32(C1), np.float32(C2), np.float32(1), np.float32(2)
    for i in range(mx.shape[0]):
        for j in range(mx.shape[1]):
            s, a, b = weight[i, j], mx[i, j], my[i, j]
            a1, b1 = two * a * b + c1, a * a + b * b + c1
            a2 = two * (mxy[i, j] - a * b) + c2
            b2 = (mxx[i, j] - a * a) + (myy[i, j] - b * b) + c2
            bottom = one / (b1 * b2)
            ssim = a1 * a2 * bottom
            square, product = -s * ssim / b2, s * two * a1 * bottom
            missed[i, j] = s * (one - ssim)
            by_square[i, j], by_product[i, j] = square, product
            mean = s * (two * b * a2 * bottom - two * a * ssim / b1)
            by_mean[i, j] = mean - two * a * square - b * product
    return missed, by_mean, by_square, by_product


@njit(cache=True, nogil=True)
def _gathered(by_mean, by_square, by_product, x, y):  # type: ignore[no-untyped-def]
    """The slope [h, n] by every pixel, of the windows it lies in."""
    slope = np.empty_like(by_mean)
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            along = np.float32(2) * x[i, j] * by_square[i, j] + y[i, j] * by_product[i, j]
            slope[i, j] = -(by_mean[i, j] + along)
    return slope
