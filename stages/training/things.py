"""Things that are no person, where a person stood: a box, a ball, a wall, grey or patterned, with a start of their own.

A network that has only ever seen people would make people of them. It is asked to leave them alone.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres, rays
from posegaussian.stages.training.starts import off_by, patches

SIDES = (0.15, 0.7)
"""Metres, shortest and longest half side of a box, or radius of a ball."""
GREY = 0.4
"""Share that has one colour all over."""
WAVES = (4.0, 60.0)
"""1/metre, coarsest and finest wave of a pattern."""
HULL_OFF = 12.0
"""Px of disparity, largest standard deviation by which the start in the hull's place is off."""


def thing(
    frame: Mapping[str, np.ndarray], views: tuple[int, int, int], centre: np.ndarray, random: np.random.Generator
) -> dict[str, np.ndarray]:
    """The two sources and the held-out camera `views` of a frame as a frame of its own, with a thing about `centre`
    [3], world metres, in place of the person; who looks for joints finds those of the person."""
    shape = _Shape(centre, random)
    intrinsics, poses = (np.stack([frame[name][v] for v in views]) for name in ("intrinsics", "world_to_camera"))
    height, width = frame["mask"].shape[1:]
    seen = [shape.seen(k, pose, (width, height)) for k, pose in zip(intrinsics, poses, strict=True)]
    truth = np.stack([s[0] for s in seen[:2]])
    found = {
        "color": np.stack([s[1] for s in seen]),
        "mask": np.stack([np.where(s[0] > 0, 255, 0).astype(np.uint8) for s in seen]),
        "truth": truth,
        "joints": frame["joints"][:, list(views[:2])],
        "intrinsics": intrinsics,
        "world_to_camera": poses,
        "pairs": np.array([[0, 1, 2]]),
    }
    sensitivity = float(intrinsics[0, 0, 0] * np.linalg.norm(poses[0, :3, 3] - poses[1, :3, 3]))
    for name, most in (("depth", 2.0), ("hull", HULL_OFF)):
        px = random.uniform(0, most)
        found[name] = np.stack([off_by(t, px * patches(t.shape, random) / sensitivity) for t in truth])
    found["confidence"] = np.where(found["depth"] > 0, random.uniform(0.3, 1.0), 0).astype(np.float16)
    return found


class _Shape:
    """A box, a ball or a wall, with a pattern in space."""

    def __init__(self, centre: np.ndarray, random: np.random.Generator) -> None:
        self.kind = ("box", "ball", "wall")[int(random.integers(3))]
        self.centre = centre
        self.half = random.uniform(*SIDES, 3)
        self.axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
        self.light = random.normal(size=3)
        self.light /= np.linalg.norm(self.light)
        self.base = random.uniform(0.05, 0.95, 3) if random.random() < 0.5 else np.full(3, random.uniform(0.05, 0.95))
        grey = random.random() < GREY
        self.contrast = 0.0 if grey else float(random.uniform(0.05, 0.5))
        waves = np.exp(random.uniform(np.log(WAVES[0]), np.log(WAVES[1]), (4, 3, 1)))
        self.waves = (waves * random.normal(size=(4, 3, 3)) / np.sqrt(3)).astype(np.float32)

    def seen(self, intrinsics: np.ndarray, pose: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Depth [h, w] float32 metres, 0 beside it, and premultiplied colour [h, w, 3] uint8 of a camera's picture."""
        origin, directions = rays(pixel_centres(size), intrinsics, pose)
        depth, normal = self._hit(origin - self.centre, directions)
        there = np.isfinite(depth) & (depth > 0.1)
        depth = np.where(there, depth, 0)
        points = (origin + directions[there] * depth[there][:, None] - self.centre).astype(np.float32)
        wave = sum(np.sin(points @ w.T) for w in self.waves) / len(self.waves)
        lit = 0.6 + 0.4 * np.clip(normal[there] @ self.light, -1, 1)
        color = np.zeros((*depth.shape, 3), np.uint8)
        color[there] = np.rint(255 * np.clip(self.base * lit[:, None] * (1 + self.contrast * wave), 0, 1))
        return depth.astype(np.float32), color

    def _hit(self, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth [h, w] of the first surface along rays from an origin [3] about the centre, not finite without one, and
        its normal [h, w, 3]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.kind == "ball":
                b, a = directions @ origin, (directions**2).sum(-1)
                depth = (-b - np.sqrt(b**2 - a * (origin @ origin - self.half[0] ** 2))) / a
                normal = (origin + directions * depth[..., None]) / self.half[0]
                return depth, np.nan_to_num(normal)
            o, d = origin @ self.axes, directions @ self.axes
            if self.kind == "wall":  # as it hangs behind whatever is filmed: across the first axis
                ahead = self.axes[:, 0] if directions[..., :].mean((0, 1)) @ self.axes[:, 0] < 0 else -self.axes[:, 0]
                return -o[0] / d[..., 0], np.broadcast_to(ahead, directions.shape)
            ends = np.stack([(-self.half - o) / d, (self.half - o) / d])
            near, far = ends.min(0), ends.max(0)
            side = near.argmax(-1)
            entered = near.max(-1)
            depth = np.where(entered < far.min(-1), entered, np.nan)
            sign = -np.sign(np.take_along_axis(d, side[..., None], -1))
            return depth, sign * self.axes.T[side]
