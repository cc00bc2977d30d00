"""The Gaussians of one source view as numbers to optimise:
offsets from the maps, in units in which a step means the same everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from posegaussian.stages.rendering.lift import GaussianMaps, Pixels
from posegaussian.stages.splatting.definition.scene import Gaussians

CHANNELS = {"color": 3, "scale": 3, "rotation": 3, "opacity": 1, "depth": 1}
"""Attributes and their channels: sRGB, log of metres, components of the normal, logit, pixel footprints z/f."""
OPACITIES = (1e-3, 1 - 1e-4)
"""Bounds of an opacity, so that its logit is finite."""
FARTHEST = {"scale": float(np.log(8)), "rotation": 1.0, "opacity": 8.0, "depth": 64.0}
"""Bounds of an offset to both sides: a Gaussian grows and shrinks to an eighth, a normal turns by 45 degrees."""
NEAREST = 0.5
"""Share of its depth by which a Gaussian may at most move: it stays in front of the camera."""

Offsets = dict[str, np.ndarray]
"""{attribute: [C, N] float32}."""


class _Exp(torch.autograd.Function):
    """e^x by numpy: torch's own may round by the element's place in the array, which threads share out."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor) -> torch.Tensor:
        y = torch.from_numpy(np.exp(x.detach().numpy()))
        ctx.save_for_backward(y)
        return y

    @staticmethod
    def backward(ctx: Any, up: torch.Tensor) -> torch.Tensor:
        return up * ctx.saved_tensors[0]


@dataclass(frozen=True, eq=False)
class Learnt:
    """What a frame learnt about a view, by pixel, for the frame after it."""

    maps: dict[str, np.ndarray]
    """{attribute: [C, h, w] float32 offsets}; 0 where there is no Gaussian."""


class ViewGaussians:
    """The Gaussians of one frame of one source view, float32 on the CPU; their opacity does not depend on the side
    they are seen from."""

    def __init__(self, maps: GaussianMaps, intrinsics: np.ndarray, world_to_camera: np.ndarray) -> None:
        """`maps` as the archive holds them; intrinsics [3, 3] px in our pixel centres; world_to_camera [4, 4]. All
        offsets are 0."""
        self.given = maps
        depth, opacity = (torch.as_tensor(np.asarray(m, np.float32)) for m in (maps.depth, maps.opacity))
        self.pixels = Pixels.of(depth, opacity[0], intrinsics, world_to_camera)
        (self.z,) = self.pixels.at(depth[None])
        self.twist = None if maps.twist is None else self.pixels.at(maps.twist)
        self.footprint = self.z * float(2 / (intrinsics[0, 0] + intrinsics[1, 1]))
        self.base: dict[str, torch.Tensor] = {
            "color": self.pixels.colors(maps.color).T.contiguous(),
            "scale": torch.from_numpy(np.log(np.maximum(self._at(maps.scale), 1e-8))),
            "rotation": torch.from_numpy(self._at(maps.normal)),
            "opacity": torch.from_numpy(_logit(np.clip(self._at(maps.opacity)[:1], *OPACITIES))),
        }
        self.offsets = {name: torch.zeros((c, len(self)), requires_grad=True) for name, c in CHANNELS.items()}
        farthest = min(FARTHEST["depth"], NEAREST * float(intrinsics[0, 0] + intrinsics[1, 1]) / 2)
        self.bounds = {**FARTHEST, "depth": farthest}

    def __len__(self) -> int:
        return len(self.z)

    def _at(self, values: Any) -> np.ndarray:
        """[C, N] float32 of maps [C, h, w]."""
        return np.asarray(values, np.float32)[:, self.pixels.rows.numpy(), self.pixels.columns.numpy()]

    def gaussians(self) -> Gaussians:
        """In the world, the same from all sides, differentiable in the offsets."""
        depth, normal, scale, opacity, color = self._values()
        faces = opacity.T.expand(-1, 2)
        return self.pixels.lift(depth, normal.unbind(0), scale.T, faces, color.T, self.twist).from_all_sides()

    def _values(self) -> tuple[torch.Tensor, ...]:
        """Depth [N] m, normal [3, N] of any length, scale [3, N] m, opacity [1, N], color [3, N]."""
        o, b = self.offsets, self.base
        return (
            self.z + o["depth"][0] * self.footprint,
            b["rotation"] + o["rotation"],
            _Exp.apply(b["scale"] + o["scale"]),
            1 / (1 + _Exp.apply(-(b["opacity"] + o["opacity"]))),
            b["color"] + o["color"],
        )

    def arrays(self) -> Offsets:
        """The offsets' own memory."""
        return {name: t.detach().numpy() for name, t in self.offsets.items()}

    def keep(self) -> Offsets:
        """A copy of the offsets."""
        return {name: a.copy() for name, a in self.arrays().items()}

    def put(self, offsets: Offsets) -> None:
        """Take offsets over, within their bounds."""
        for name, a in self.arrays().items():
            a[...] = offsets[name]
        self.confine()

    def reset(self) -> None:
        """All offsets 0 again."""
        for a in self.arrays().values():
            a[...] = 0

    def confine(self) -> None:
        """Bring the offsets back within their bounds; colours stay within 0..1."""
        for name, a in self.arrays().items():
            if name == "color":
                base = self.base["color"].numpy()
                np.clip(a, -base, 1 - base, out=a)
            else:
                np.clip(a, -self.bounds[name], self.bounds[name], out=a)

    def learnt(self) -> Learnt:
        """The offsets by pixel."""
        rows, columns = self.pixels.rows.numpy(), self.pixels.columns.numpy()
        maps = {name: np.zeros((CHANNELS[name], *np.shape(self.given.depth)), np.float32) for name in CHANNELS}
        for name, a in self.arrays().items():
            maps[name][:, rows, columns] = a
        return Learnt(maps)

    def start_from(self, learnt: Learnt) -> None:
        """Take over, pixel by pixel, what another frame of the same view learnt."""
        self.put({name: self._at(m) for name, m in learnt.maps.items()})

    def maps(self) -> GaussianMaps:
        """The optimised maps, types as given;
        a pixel whose Gaussian is not finite, or that has none, stays as it was."""
        with torch.no_grad():
            depth, normal, scale, opacity, color = (t.numpy() for t in self._values())
        length = np.sqrt((normal * normal).sum(axis=0))
        good = (
            np.isfinite(depth)
            & np.isfinite(normal).all(axis=0)
            & np.isfinite(scale).all(axis=0)
            & np.isfinite(opacity).all(axis=0)
            & np.isfinite(color).all(axis=0)
            & (length > 0)
        )
        rows, columns = self.pixels.rows.numpy()[good], self.pixels.columns.numpy()[good]
        given = self.given
        colors, depths = np.array(given.color), np.array(given.depth)
        scales, normals, opacities = np.array(given.scale), np.array(given.normal), np.array(given.opacity)
        colors[rows, columns] = np.rint(color[:, good].T * 255).clip(0, 255)
        depths[rows, columns] = depth[good]
        for target, values in (
            (scales, scale),
            (normals, normal / np.where(length > 0, length, 1)),
            (opacities, opacity),
        ):
            target[:, rows, columns] = values[:, good]
        return GaussianMaps(colors, depths, scales, normals, opacities, given.twist)


def _logit(p: np.ndarray) -> np.ndarray:
    return np.log(p / (1 - p)).astype(np.float32)
