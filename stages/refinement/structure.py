"""D-SSIM of a rendering and a picture, and its gradient."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import torch

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
"""Of SSIM, for values in 0..1 (Wang et al., 2004)."""
_KERNEL = cv2.getGaussianKernel(WINDOW, SIGMA, cv2.CV_32F)


def dissimilarity(color: torch.Tensor, truth: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Sum over the pixels of weight [h, w] times the mean over channels of (1 - SSIM) / 2 of color and truth [h, w, 3],
    0..1; differentiable in `color` alone.

    Outside the picture all is 0, as published with 3DGS, so the window is its own adjoint. OpenCV filters row by row:
    the result does not depend on threads.
    """
    value: torch.Tensor = _Dissimilarity.apply(color, truth.numpy(), weight.detach().numpy())
    return value


class _Dissimilarity(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, color: torch.Tensor, truth: np.ndarray, weight: np.ndarray) -> torch.Tensor:
        x = color.detach().numpy()
        box = _box((x != 0).any(axis=2) | (truth != 0).any(axis=2))
        value, gradient = _value_and_gradient(x[box], truth[box], weight[box][..., None])
        whole = np.zeros_like(x)
        whole[box] = gradient
        ctx.save_for_backward(torch.from_numpy(whole))
        return color.new_tensor(value)

    @staticmethod
    def backward(ctx: Any, up: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        return up * ctx.saved_tensors[0], None, None


def _box(wanted: np.ndarray) -> tuple[slice, slice]:
    """What is around the wanted pixels [h, w] as far as two windows reach: beyond it both pictures are equal."""
    out = []
    for axis in (1, 0):
        found = np.flatnonzero(wanted.any(axis=axis))
        out.append(slice(max(int(found[0]) - WINDOW, 0), int(found[-1]) + WINDOW + 1) if len(found) else slice(0, 1))
    return out[0], out[1]


def _blur(values: np.ndarray) -> np.ndarray:
    blurred: np.ndarray = cv2.sepFilter2D(values, -1, _KERNEL, _KERNEL, borderType=cv2.BORDER_CONSTANT)
    return blurred


def _value_and_gradient(x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray]:
    """Of [h, w, 3] float32 x and y, weight [h, w, 1]."""
    x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
    mx, my = _blur(x), _blur(y)
    a1, a2 = 2 * mx * my + C1, 2 * (_blur(x * y) - mx * my) + C2
    b1, b2 = mx * mx + my * my + C1, _blur(x * x) - mx * mx + _blur(y * y) - my * my + C2
    bottom = 1 / (b1 * b2)
    ssim = a1 * a2 * bottom
    share = (weight / 6).astype(np.float32)
    by_mean = share * (2 * my * a2 * bottom - 2 * mx * ssim / b1)
    by_square, by_product = -share * ssim / b2, share * 2 * a1 * bottom
    slope = _blur(by_mean - 2 * mx * by_square - my * by_product) + 2 * x * _blur(by_square) + y * _blur(by_product)
    return float((share * (1 - ssim)).sum(dtype=np.float64)), -slope
