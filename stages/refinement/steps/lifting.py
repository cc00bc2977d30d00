"""Pixels of several views lifted into the world, and back: what a change of the Gaussians says of depths, normals,
turns and shifts. As `posegaussian/stages/rendering/lift.py` has it, for all views in one pass, whose order no thread
changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.rendering.lift import Pixels, place, turn, unit


@dataclass(frozen=True, eq=False)
class Rays:
    """Where the pixels of several views look, those of a view side by side; float32."""

    x: np.ndarray
    """[N] of the ray through the pixel's centre at unit depth, camera axes."""
    y: np.ndarray
    """[N]"""
    pitch: np.ndarray
    """[V, 3] of x by a pixel to the right and by one down, of y by one down."""
    starts: np.ndarray
    """[V + 1] where each view's pixels begin, and the end."""
    poses: np.ndarray
    """[V, 3, 4] world to camera."""

    @classmethod
    def of(cls, parts: Sequence[Pixels]) -> Rays:
        """Those of each view's pixels, which are on the CPU."""
        starts = np.cumsum([0, *(len(p) for p in parts)])
        x, y = (np.concatenate([getattr(p, name).numpy() for p in parts]).astype(np.float32) for name in ("x", "y"))
        pitch, poses = (np.array([getattr(p, name) for p in parts], np.float32) for name in ("pitch", "pose"))
        return cls(x, y, pitch, starts, poses[:, :3])

    def shifted(self, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """X and y [N] of rays so many px [2, N] right of and below these."""
        x, y = np.empty_like(self.x), np.empty_like(self.y)
        _shift(shift, self.x, self.y, self.pitch, self.starts, x, y)
        return x, y

    def lifted(
        self, depth: np.ndarray, normal: np.ndarray, twist: np.ndarray, shift: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """([N, 3] centres, world metres; [N, 3, 3] columns (tangent, tangent, normal), world axes) of depths [N] m,
        normals [3, N] of any length, camera axes, turns [2, N], cosine and sine of any length, and shifts [2, N] px."""
        mean, rotation = np.empty((len(depth), 3), np.float32), np.empty((len(depth), 3, 3), np.float32)
        place(depth, normal, twist, *self.shifted(shift), self.starts, self.poses, mean, rotation)
        return mean, rotation

    def slopes(
        self,
        depth: np.ndarray,
        normal: np.ndarray,
        twist: np.ndarray,
        shift: np.ndarray,
        by_mean: np.ndarray,
        by_rotation: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What a value's slopes by centres [N, 3] and axes [N, 3, 3] are by depths [N], normals [3, N], turns [2, N]
        and shifts [2, N]. What has no length has no slope."""
        by_depth = np.empty(len(self.x), np.float32)
        by_normal, by_twist, by_shift = np.empty_like(normal), np.empty_like(twist), np.empty_like(shift)
        made, by = (depth, normal, twist, *self.shifted(shift)), (by_mean, by_rotation)
        _slopes(*made, self.pitch, self.starts, self.poses, *by, by_depth, by_normal, by_twist, by_shift)
        return by_depth, by_normal, by_twist, by_shift


@compiled(error_model="numpy")
def _shift(shift, x, y, pitch, starts, shifted_x, shifted_y):  # type: ignore[no-untyped-def]
    """As `Rays.shifted`, into the last two."""
    for view in range(len(pitch)):
        for n in range(starts[view], starts[view + 1]):
            shifted_x[n] = x[n] + pitch[view, 0] * shift[0, n] + pitch[view, 1] * shift[1, n]
            shifted_y[n] = y[n] + pitch[view, 2] * shift[1, n]


@compiled(error_model="numpy")
def _slopes(  # type: ignore[no-untyped-def]
    depth, normal, twist, x, y, pitch, starts, poses, by_mean, by_rotation, by_depth, by_normal, by_twist, by_shift
):
    """As `Rays.slopes`, into the last four; x and y [N] of the rays as they are shifted."""
    one, two, none = np.float32(1), np.float32(2), np.float32(0)
    g = np.empty((3, 3), np.float32)  # slopes by the axes, camera's: rows tangent, tangent, normal
    for view in range(len(poses)):
        p = poses[view]
        for n in range(starts[view], starts[view + 1]):
            m0, m1, m2 = by_mean[n, 0], by_mean[n, 1], by_mean[n, 2]
            right = p[0, 0] * m0 + p[0, 1] * m1 + p[0, 2] * m2
            down = p[1, 0] * m0 + p[1, 1] * m1 + p[1, 2] * m2
            by_depth[n] = x[n] * right + y[n] * down + (p[2, 0] * m0 + p[2, 1] * m1 + p[2, 2] * m2)
            by_shift[0, n] = depth[n] * pitch[view, 0] * right
            by_shift[1, n] = depth[n] * (pitch[view, 1] * right + pitch[view, 2] * down)
            for axis in range(3):
                r0, r1, r2 = by_rotation[n, 0, axis], by_rotation[n, 1, axis], by_rotation[n, 2, axis]
                for i in range(3):
                    g[axis, i] = p[i, 0] * r0 + p[i, 1] * r1 + p[i, 2] * r2
            nx, ny, nz, long = unit(normal[0, n], normal[1, n], normal[2, n])
            c, s, turned = turn(twist[0, n], twist[1, n])
            k = one / (one - nz)
            xy = k * nx * ny
            ax, ay, az = one - k * nx * nx, -xy, nx
            bx, by, bz = xy, k * ny * ny - one, -ny
            by_c = g[0, 0] * ax + g[0, 1] * ay + g[0, 2] * az + g[1, 0] * bx + g[1, 1] * by + g[1, 2] * bz
            by_s = g[0, 0] * bx + g[0, 1] * by + g[0, 2] * bz - g[1, 0] * ax - g[1, 1] * ay - g[1, 2] * az
            along = c * by_c + s * by_s
            by_twist[0, n] = (by_c - c * along) / turned if turned > 0 else none
            by_twist[1, n] = (by_s - s * along) / turned if turned > 0 else none
            a0, a1, a2 = c * g[0, 0] - s * g[1, 0], c * g[0, 1] - s * g[1, 1], c * g[0, 2] - s * g[1, 2]
            b0, b1, b2 = s * g[0, 0] + c * g[1, 0], s * g[0, 1] + c * g[1, 1], s * g[0, 2] + c * g[1, 2]
            mixed = b0 - a1
            by_k = nx * ny * mixed - a0 * nx * nx + b1 * ny * ny
            by_x = g[2, 0] + k * (ny * mixed - two * nx * a0) + a2
            by_y = g[2, 1] + k * (nx * mixed + two * ny * b1) - b2
            by_z = g[2, 2] + k * k * by_k
            along = nx * by_x + ny * by_y + nz * by_z
            by_normal[0, n] = (by_x - nx * along) / long if long > 0 else none
            by_normal[1, n] = (by_y - ny * along) / long if long > 0 else none
            by_normal[2, n] = (by_z - nz * along) / long if long > 0 else none
