"""LPIPS: Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", 2018, version 0.1.

Both pictures go through a network that was trained to classify. At five depths the features of each pixel are scaled to
unit length, their squared differences weighed by a trained linear layer and averaged over the picture; the sum is
LPIPS.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn import functional

SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""What the networks were trained with, for inputs in -1..1."""
EPS = 1e-10
"""Added to the length of a feature, as in the authors' code."""


@dataclass(frozen=True)
class Convolution:
    """One convolution with its rectifier."""

    key: str
    """Name of the layer in the file of weights."""
    channels: tuple[int, int]
    """In, out."""
    size: int
    """Side of the kernel, px."""
    stride: int = 1
    padding: int = 1
    pool: int = 0
    """Side of the maximum over pixels, 2 apart, taken before it; 0: none."""
    compared: bool = False
    """Whether its output is one of the five that are compared."""


@dataclass(frozen=True)
class Stack:
    """A network up to the last features that are compared."""

    layers: tuple[Convolution, ...]
    smallest: int
    """Px a side must have for every layer to have a pixel."""

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of the features that are compared."""
        return tuple(c.channels[1] for c in self.layers if c.compared)


ALEX = Stack(
    (
        Convolution("features.0", (3, 64), 11, stride=4, padding=2, compared=True),
        Convolution("features.3", (64, 192), 5, padding=2, pool=3, compared=True),
        Convolution("features.6", (192, 384), 3, pool=3, compared=True),
        Convolution("features.8", (384, 256), 3, compared=True),
        Convolution("features.10", (256, 256), 3, compared=True),
    ),
    smallest=31,
)
"""Krizhevsky, 2014, as in torchvision's `alexnet`."""


def _vgg() -> Stack:
    layers, number, last = [], 0, 3
    for block, (count, width) in enumerate(((2, 64), (2, 128), (3, 256), (3, 512), (3, 512))):
        for i in range(count):
            layers.append(
                Convolution(
                    f"features.{number}", (last, width), 3, pool=2 if block and not i else 0, compared=i == count - 1
                )
            )
            number, last = number + 2, width
        number += 1
    return Stack(tuple(layers), smallest=16)


VGG = _vgg()
"""Simonyan and Zisserman, 2015, configuration D, as in torchvision's `vgg16`."""
STACKS = {"lpips_alex": ALEX, "lpips_vgg": VGG}
"""By measure."""


@dataclass(frozen=True, eq=False)
class Network:
    """A stack with its weights."""

    stack: Stack
    weights: Mapping[str, tuple[torch.Tensor, torch.Tensor]]
    """{key: kernel [out, in, size, size] and bias [out]}."""
    linear: tuple[torch.Tensor, ...]
    """[C] of every compared feature."""

    @torch.no_grad()
    def distance(self, picture: np.ndarray, truth: np.ndarray, data_range: float) -> float:
        """LPIPS of two sRGB pictures [h, w, 3] with values 0..data_range, 0 for equal ones; float32.

        Raises ValueError for unequal shapes, sides below `stack.smallest`, and values that are not finite.
        """
        if (
            picture.shape != truth.shape
            or picture.ndim != 3
            or picture.shape[2] != 3
            or min(picture.shape[:2]) < self.stack.smallest
        ):
            raise ValueError(
                f"LPIPS compares pictures [h, w, 3] of equal shape with sides of {self.stack.smallest} px or more, got"
                f" {picture.shape} and {truth.shape}"
            )
        both = np.stack([picture, truth]).astype(np.float64) / data_range * 2 - 1
        if not np.isfinite(both).all():
            raise ValueError("LPIPS of a picture that holds NaN or infinity")
        scaled = ((both - np.array(SHIFT)) / np.array(SCALE)).astype(np.float32)
        x = torch.from_numpy(np.ascontiguousarray(scaled.transpose(0, 3, 1, 2)))
        total, compared = 0.0, iter(self.linear)
        for layer in self.stack.layers:
            if layer.pool:
                x = functional.max_pool2d(x, layer.pool, 2)
            kernel, bias = self.weights[layer.key]
            x = functional.relu_(functional.conv2d(x, kernel, bias, layer.stride, layer.padding))
            if layer.compared:
                total += _difference(x, next(compared))
        return total


def _difference(features: torch.Tensor, linear: torch.Tensor) -> float:
    """Mean over pixels of sum_c w_c (a_c / |a| - b_c / |b|)^2, for features [2, C, h, w] and weights [C]."""
    length = torch.sqrt((features * features).sum(dim=1)) + EPS  # [2, h, w]
    apart = features[0] / length[0]
    apart -= features[1] / length[1]
    weighed = apart.square_().mul_(linear[:, None, None]).sum(dim=0)
    return float(weighed.numpy().astype(np.float64).mean())
