"""Pixels of several views lifted into the world, and back: what a change of the Gaussians says of depths, normals and
turns. As `posegaussian/stages/rendering/lift.py` has it, for all views in one pass, whose order no thread changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from posegaussian.stages.rendering.lift import Pixels, place, turn, unit


@dataclass(frozen=True, eq=False)
class Rays:
    """Where the pixels of several views look, those of a view side by side; float32."""

    x: np.ndarray
    """[N] of the ray through the pixel's centre at unit depth, camera axes."""
    y: np.ndarray
    """[N]"""
    starts: np.ndarray
    """[V + 1] where each view's pixels begin, and the end."""
    poses: np.ndarray
    """[V, 3, 4] world to camera."""

    @classmethod
    def of(cls, parts: Sequence[Pixels]) -> Rays:
        """Those of each view's pixels, which are on the CPU."""
        starts = np.cumsum([0, *(len(p) for p in parts)])
        x, y = (np.concatenate([getattr(p, name).numpy() for p in parts]).astype(np.float32) for name in ("x", "y"))
        return cls(x, y, starts, np.array([p.pose for p in parts], np.float32)[:, :3])

    def lifted(self, depth: np.ndarray, normal: np.ndarray, twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """([N, 3] centres, world metres; [N, 3, 3] columns (tangent, tangent, normal), world axes) of depths [N] m,
        normals [3, N] of any length, camera axes, and turns [2, N], cosine and sine of any length."""
        mean, rotation = np.empty((len(depth), 3), np.float32), np.empty((len(depth), 3, 3), np.float32)
        place(depth, normal, twist, self.x, self.y, self.starts, self.poses, mean, rotation)
        return mean, rotation

    def slopes(
        self, normal: np.ndarray, twist: np.ndarray, by_mean: np.ndarray, by_rotation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What a value's slopes by centres [N, 3] and axes [N, 3, 3] are by depths [N], normals [3, N] and turns
        [2, N]. What has no length has no slope."""
        by_depth = np.empty(len(self.x), np.float32)
        by_normal, by_twist = np.empty_like(normal), np.empty_like(twist)
        _slopes(
            normal, twist, self.x, self.y, self.starts, self.poses, by_mean, by_rotation, by_depth, by_normal, by_twist
        )
        return by_depth, by_normal, by_twist


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(normal, twist, x, y, starts, poses, by_mean, by_rotation, by_depth, by_normal, by_twist):  # type: ignore[no-untyped-def]
    """As `Rays.slopes`, into the last three."""
    one, two, none = np.float32(1), np.float32(2), np.float32(0)
    g = np.empty((3, 3), np.float32)  # slopes by the axes, camera's: rows tangent, tangent, normal
    for view in range(len(poses)):
        p = poses[view]
        for n in range(starts[view], starts[view + 1]):
            m0, m1, m2 = by_mean[n, 0], by_mean[n, 1], by_mean[n, 2]
            by_depth[n] = (
                x[n] * (p[0, 0] * m0 + p[0, 1] * m1 + p[0, 2] * m2)
                + y[n] * (p[1, 0] * m0 + p[1, 1] * m1 + p[1, 2] * m2)
                + (p[2, 0] * m0 + p[2, 1] * m1 + p[2, 2] * m2)
            )
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
