"""The Gaussians of one frame's source views as numbers to optimise: offsets from the maps, in units in which a step
means the same everywhere, those of all views side by side."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from posegaussian.stages.refinement.steps.lifting import Rays
from posegaussian.stages.rendering.lift import GaussianMaps, Pixels, Places, twist_of
from posegaussian.stages.splatting.definition.scene import Gaussians

CHANNELS = {"color": 3, "scale": 3, "rotation": 3, "opacity": 1, "depth": 1, "twist": 1, "shift": 2}
"""Attributes and their channels: sRGB, log of metres, components of the normal, logit, pixel footprints z/f, tangent of
the turn about the normal, px to the right and down in the picture that it is of."""
OPACITIES = (1e-3, 1 - 1e-4)
"""Bounds of an opacity, so that its logit is finite."""
FARTHEST = {"scale": float(np.log(8)), "rotation": 1.0, "opacity": 8.0, "depth": 64.0, "twist": 2.0, "shift": 3.0}
"""Bounds of an offset to both sides: a Gaussian grows and shrinks to an eighth, a normal turns by 45 degrees, what lies
along a tangent by 63; a shift is three px each way."""
NEAREST = 0.5
"""Share of its depth by which a Gaussian may at most move: it stays in front of the camera."""

Offsets = dict[str, np.ndarray]
"""{attribute: [C, N] float32}."""


@dataclass(frozen=True, eq=False)
class ViewGaussians:
    """The Gaussians of one frame of one source view, as they are given, float32 on the CPU."""

    given: GaussianMaps
    pixels: Pixels
    twist: np.ndarray
    """[2, N] cosine and sine of the turn about the normal."""
    base: dict[str, np.ndarray]
    """{attribute: [C, N]}; depth in metres."""
    footprint: np.ndarray
    """[1, N] metres of an offset in depth."""
    farthest: float
    """Bound of an offset in depth."""

    @classmethod
    def of(cls, maps: GaussianMaps, intrinsics: np.ndarray, world_to_camera: np.ndarray) -> ViewGaussians:
        """`maps` as the archive holds them; intrinsics [3, 3] px in our pixel centres; world_to_camera [4, 4]."""
        depth, opacity = (torch.as_tensor(np.asarray(m, np.float32)) for m in (maps.depth, maps.opacity))
        pixels = Pixels.of(depth, opacity[0], intrinsics, world_to_camera, shift=maps.shift)
        z = pixels.at(depth[None])[0].numpy()[None]
        focal = float(intrinsics[0, 0] + intrinsics[1, 1]) / 2
        scale, normal, faces = (
            np.stack([c.numpy() for c in pixels.at(np.asarray(m, np.float32))])
            for m in (maps.scale, maps.normal, maps.opacity)
        )
        base = {
            "color": np.ascontiguousarray(pixels.colors(maps.color).numpy().T),
            "scale": np.log(np.maximum(scale, np.float32(1e-8))),
            "rotation": normal,
            "opacity": _logit(np.clip(faces[:1], *OPACITIES)),
            "depth": z,
        }
        cosine, sine = (c.numpy() for c in pixels.at(twist_of(maps)))
        twist = np.stack([np.where((cosine == 0) & (sine == 0), np.float32(1), cosine), sine])
        return cls(maps, pixels, twist, base, z / np.float32(focal), min(FARTHEST["depth"], NEAREST * focal))

    def __len__(self) -> int:
        return len(self.pixels)

    def with_values(self, values: Mapping[str, np.ndarray]) -> GaussianMaps:
        """The Gaussians as a list, with other {attribute: [C, N]}, depth and scale in metres, normals and turns of any
        length, types as given; one that is not finite stays as it was."""
        (normals, length), (turns, _) = (_unit(values[name]) for name in ("rotation", "twist"))
        good = np.all([np.isfinite(v).all(axis=0) for v in values.values()], axis=0) & (length > 0)
        g = self._listed()
        color, depth = np.array(g.color), np.array(g.depth)
        scale, normal, opacity, twist, shift = (np.array(a) for a in g.channels())
        color[0, good] = np.rint(values["color"][:, good].T * 255).clip(0, 255)
        depth[0, good] = values["depth"][0, good]
        scale[:, 0, good] = values["scale"][:, good]
        normal[:, 0, good] = normals[:, good]
        opacity[:, 0, good] = values["opacity"][:, good]
        twist[:, 0, good] = turns[:, good]
        shift[:, 0, good] += values["shift"][:, good]
        return GaussianMaps(color, depth, scale, normal, opacity, twist, shift, g.places)

    def _listed(self) -> GaussianMaps:
        """As they are given."""
        g, at = self.given, self.pixels.index.numpy()
        scale, normal, opacity, twist, shift = (a.reshape(len(a), 1, -1)[..., at] for a in g.channels())
        color, depth = np.asarray(g.color).reshape(1, -1, 3)[:, at], np.asarray(g.depth).reshape(1, -1)[:, at]
        places = Places(self.pixels.pixel.numpy().astype(np.int32)[None], np.shape(g.depth)[1])
        return GaussianMaps(color, depth, scale, normal, opacity, twist, shift, places)


class SharedGaussians:
    """The Gaussians of several views of one frame as one body; their opacity does not depend on the side they are seen
    from. All offsets begin at 0."""

    def __init__(self, views: Mapping[int, ViewGaussians]) -> None:
        """{view: its Gaussians}."""
        self.views = dict(views)
        parts = list(views.values())
        self.rays = Rays.of([p.pixels for p in parts])
        self.base = {n: np.concatenate([p.base[n] for p in parts], axis=1) for n in parts[0].base}
        self.footprint = np.concatenate([p.footprint for p in parts], axis=1)
        self.twist = np.concatenate([p.twist for p in parts], axis=1)
        farthest = np.concatenate([np.full((1, len(p)), p.farthest, np.float32) for p in parts], axis=1)
        color = self.base["color"]
        self.bounds: dict[str, tuple[Any, Any]] = {
            **{name: (-f, f) for name, f in FARTHEST.items()},
            "depth": (-farthest, farthest),
            "color": (-color, 1 - color),
        }
        self.offsets: Offsets = {name: np.zeros((c, len(self)), np.float32) for name, c in CHANNELS.items()}
        self._made: dict[str, np.ndarray] = {}
        """What the last Gaussians were made of."""

    def __len__(self) -> int:
        return len(self.rays.x)

    def gaussians(self) -> Gaussians:
        """In the world, the same from all sides; each a leaf, whose gradient `slopes` carries on to the offsets, as
        they are until the next are made."""
        v = self._values()
        self._made = v
        mean, rotation = self.rays.lifted(v["depth"][0], v["rotation"], v["twist"], v["shift"])
        scale, color = (np.ascontiguousarray(v[name].T) for name in ("scale", "color"))
        made = (mean, rotation, scale, v["opacity"][0], color)
        return Gaussians(*(torch.from_numpy(a).requires_grad_() for a in made))

    def with_offsets(self, offsets: Offsets) -> SharedGaussians:
        """The same Gaussians moved by other offsets, which are not copied."""
        other = copy(self)
        other.offsets = offsets
        return other

    def slopes(self, gaussians: Gaussians) -> Offsets:
        """What the gradients of `gaussians`, the last that were made, are by the offsets they were made of."""
        v, (cosine, sine) = self._made, self.twist
        mean, rotation, scale, opacity, color = (_gradient(t) for t in vars(gaussians).values())
        scale, color = (np.ascontiguousarray(slope.T) for slope in (scale, color))
        by_depth, by_normal, by_twist, by_shift = self.rays.slopes(
            v["depth"][0], v["rotation"], v["twist"], v["shift"], mean, rotation
        )
        p = v["opacity"]
        return {
            "color": color,
            "scale": scale * v["scale"],
            "rotation": by_normal,
            "opacity": opacity[None] * p * (1 - p),
            "depth": by_depth[None] * self.footprint,
            "twist": (by_twist[1] * cosine - by_twist[0] * sine)[None],
            "shift": by_shift,
        }

    def _values(self) -> dict[str, np.ndarray]:
        """{attribute: [C, N]}: colour in sRGB, scale and depth in m, opacity 0..1, a normal and a turn
        of any length, a shift in px."""
        o, b, (cosine, sine) = self.offsets, self.base, self.twist
        return {
            "color": b["color"] + o["color"],
            "scale": np.exp(b["scale"] + o["scale"]),
            "rotation": b["rotation"] + o["rotation"],
            "opacity": 1 / (1 + np.exp(-(b["opacity"] + o["opacity"]))),
            "depth": b["depth"] + o["depth"] * self.footprint,
            "twist": np.stack([cosine - o["twist"][0] * sine, sine + o["twist"][0] * cosine]),
            "shift": o["shift"],
        }

    def confine(self) -> None:
        """Bring the offsets back within their bounds; colours stay within 0..1."""
        for name, a in self.offsets.items():
            np.clip(a, *self.bounds[name], out=a)

    def lists(self) -> dict[int, GaussianMaps]:
        """{view: its optimised Gaussians}."""
        values = self._values()
        found, start = {}, 0
        for view, part in self.views.items():
            stop = start + len(part)
            found[view] = part.with_values({name: v[:, start:stop] for name, v in values.items()})
            start = stop
        return found


def _gradient(leaf: torch.Tensor) -> np.ndarray:
    """Of a tensor; 0 where nothing depended on it."""
    return np.zeros(leaf.shape, np.float32) if leaf.grad is None else leaf.grad.numpy()


def _unit(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors [C, N] at unit length, and their lengths [N]; what has none stays as it is."""
    length = np.sqrt((vectors**2).sum(axis=0))
    return vectors / np.where(length > 0, length, 1), length


def _logit(p: np.ndarray) -> np.ndarray:
    return np.log(p / (1 - p)).astype(np.float32)
