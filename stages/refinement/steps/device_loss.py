"""What a rendering is trained to have less of, on a device: the slopes of `posegaussian.stages.refinement.steps.loss`
by three kernels, a pixel a lane, and torch's convolutions, whose window is its own adjoint."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
import triton
import triton.language as tl
from torch.nn.functional import conv2d

from posegaussian.stages.refinement.steps.loss import COVERAGE, STRUCTURE, Filmed
from posegaussian.stages.refinement.steps.structure import C1, C2, KERNEL, WINDOW
from posegaussian.stages.splatting.definition.scene import Camera

BLOCK = 256
"""Pixels of a program."""
_BLOCK, _C1, _C2 = tl.constexpr(BLOCK), tl.constexpr(C1), tl.constexpr(C2)
_STRUCTURE, _THIRD, _COVERAGE = tl.constexpr(STRUCTURE / 6), tl.constexpr((1 - STRUCTURE) / 3), tl.constexpr(COVERAGE)


@dataclass(frozen=True, eq=False)
class DevicePicture:
    """One source picture on a device."""

    camera: Camera
    color: torch.Tensor  # [3, h, w]
    """sRGB 0..1, premultiplied by the mask."""
    cover: torch.Tensor  # [h, w]
    """The mask, 0..1."""
    beside: torch.Tensor  # [h, w]
    """Weight of what should be empty."""
    moments: torch.Tensor  # [6, h, w]
    """Mean of the picture and of its squares around every pixel, under SSIM's window."""

    @classmethod
    def of(cls, filmed: Filmed, device: torch.device) -> DevicePicture:
        """Of a picture on the CPU."""
        color = torch.from_numpy(np.ascontiguousarray(filmed.color.transpose(2, 0, 1))).to(device)
        moments = blur(torch.cat([color, color * color]))
        cover, beside = (torch.from_numpy(np.ascontiguousarray(a)).to(device) for a in (filmed.cover, filmed.beside))
        return cls(filmed.camera, color, cover, beside, moments)


def device_loss(color: torch.Tensor, alpha: torch.Tensor, picture: DevicePicture) -> tuple[torch.Tensor, torch.Tensor]:
    """Slopes of the loss by color [h, w, 3] and alpha [h, w] as rendered, contiguous."""
    height, width = alpha.shape
    n = height * width
    grid = (triton.cdiv(n, BLOCK),)
    planes = color.new_empty((9, height, width))
    _products[grid](color, picture.color, planes, n)
    slopes = torch.empty_like(planes)
    _structure[grid](blur(planes), picture.moments, alpha, picture.cover, picture.beside, slopes, n)
    by_color, by_alpha = torch.empty_like(color), torch.empty_like(alpha)
    own = picture.color, alpha, picture.cover, picture.beside
    _gathered[grid](blur(slopes), color, *own, by_color, by_alpha, n)
    return by_color, by_alpha


def blur(pictures: torch.Tensor) -> torch.Tensor:
    """Pictures [C, h, w] under SSIM's window; outside of them all is 0. A channel a group: what torch convolves so are
    plain float32 sums, which TF32 does not shorten."""
    count, reach = len(pictures), WINDOW // 2
    window = _window(pictures.device).expand(count, 1, -1, 1)
    down = conv2d(pictures[None], window, padding=(reach, 0), groups=count)
    return conv2d(down, window.transpose(2, 3), padding=(0, reach), groups=count)[0]


@cache
def _window(device: torch.device) -> torch.Tensor:
    """[1, 1, WINDOW, 1] SSIM's, down."""
    return torch.from_numpy(KERNEL).to(device).reshape(1, 1, -1, 1)


@triton.jit
def _products(color, picture, planes, n):
    """Write x, x x and x y [9, h, w] of a rendering [h, w, 3] and the picture [3, h, w]."""
    at = tl.program_id(0) * _BLOCK + tl.arange(0, _BLOCK)
    listed = at < n
    for c in tl.static_range(3):
        x = tl.load(color + 3 * at + c, mask=listed, other=0.0)
        y = tl.load(picture + c * n + at, mask=listed, other=0.0)
        tl.store(planes + c * n + at, x, mask=listed)
        tl.store(planes + (3 + c) * n + at, x * x, mask=listed)
        tl.store(planes + (6 + c) * n + at, x * y, mask=listed)


@triton.jit
def _weight(alpha, cover, beside, at, listed):
    """That of its own beside the person, and the rendered alpha on the person."""
    on = tl.load(cover + at, mask=listed, other=0.0) > 0.0
    drawn = tl.load(alpha + at, mask=listed, other=0.0)
    return tl.where(on, drawn, tl.load(beside + at, mask=listed, other=0.0))


@triton.jit
def _structure(means, moments, alpha, cover, beside, slopes, n):
    """Write what D-SSIM changes by with the window's mean, its squares and its products [9, h, w]."""
    at = tl.program_id(0) * _BLOCK + tl.arange(0, _BLOCK)
    listed = at < n
    s = _STRUCTURE * _weight(alpha, cover, beside, at, listed)
    for c in tl.static_range(3):
        a = tl.load(means + c * n + at, mask=listed, other=0.0)
        aa = tl.load(means + (3 + c) * n + at, mask=listed, other=0.0)
        ab = tl.load(means + (6 + c) * n + at, mask=listed, other=0.0)
        b = tl.load(moments + c * n + at, mask=listed, other=0.0)
        bb = tl.load(moments + (3 + c) * n + at, mask=listed, other=0.0)
        a1, b1 = 2.0 * a * b + _C1, a * a + b * b + _C1
        a2, b2 = 2.0 * (ab - a * b) + _C2, (aa - a * a) + (bb - b * b) + _C2
        bottom = 1.0 / (b1 * b2)
        ssim = a1 * a2 * bottom
        square, product = -s * ssim / b2, s * 2.0 * a1 * bottom
        mean = s * (2.0 * b * a2 * bottom - 2.0 * a * ssim / b1) - 2.0 * a * square - b * product
        tl.store(slopes + c * n + at, mean, mask=listed)
        tl.store(slopes + (3 + c) * n + at, square, mask=listed)
        tl.store(slopes + (6 + c) * n + at, product, mask=listed)


@triton.jit
def _gathered(by_window, color, picture, alpha, cover, beside, by_color, by_alpha, n):
    """Write the slopes by every pixel: of the windows it lies in, and of its own difference."""
    at = tl.program_id(0) * _BLOCK + tl.arange(0, _BLOCK)
    listed = at < n
    w = _weight(alpha, cover, beside, at, listed)
    for c in tl.static_range(3):
        x = tl.load(color + 3 * at + c, mask=listed, other=0.0)
        y = tl.load(picture + c * n + at, mask=listed, other=0.0)
        mean = tl.load(by_window + c * n + at, mask=listed, other=0.0)
        square = tl.load(by_window + (3 + c) * n + at, mask=listed, other=0.0)
        product = tl.load(by_window + (6 + c) * n + at, mask=listed, other=0.0)
        tl.store(
            by_color + 3 * at + c, w * _THIRD * _sign(x - y) - (mean + 2.0 * x * square + y * product), mask=listed
        )
    off = tl.load(alpha + at, mask=listed, other=0.0) - tl.load(cover + at, mask=listed, other=0.0)
    tl.store(by_alpha + at, w * _COVERAGE * _sign(off), mask=listed)


@triton.jit
def _sign(x):
    return tl.where(x > 0.0, 1.0, tl.where(x < 0.0, -1.0, 0.0))
