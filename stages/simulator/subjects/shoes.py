"""Shoes: a loft along each foot, a rounded box around its outline on a flat sole, so that no toe shows through."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.simulator.render.mesh import Mesh, Texture
from posegaussian.stages.simulator.subjects.bodies import Body
from posegaussian.stages.simulator.subjects.skeleton import BONES, SIDES

SOLE = 0.022
"""Thickness of a sole, metres; a shod body stands that much higher."""
SLICES, TOP = 30, 15
"""Cross-sections along a foot, and points over the upper of each."""
_LEATHER = 0.007


def shoes(body: Body, upper: Texture, sole: Texture) -> Mesh:
    """Both shoes: layer 0 the uppers, layer 1 the soles. The foot lies within, from the ankle down."""
    parts = [_loft(body, side) for side in SIDES]
    points = np.concatenate([p for p, _, _ in parts])
    count, around = SLICES, parts[0][1]
    grid = np.arange(count * around).reshape(count, around)
    a, b = grid[:-1, :], np.roll(grid[:-1, :], -1, axis=1)
    c, d = grid[1:, :], np.roll(grid[1:, :], -1, axis=1)
    one = np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([b, d, c], axis=-1).reshape(-1, 3)])
    column = np.concatenate([np.tile(np.arange(around), count - 1)] * 2)
    ends = [
        [grid[row, 0], *pair]
        for row in (0, count - 1)
        for k in range(1, around - 1)
        for pair in [grid[row, [k, k + 1] if row else [k + 1, k]]]
    ]
    tris = np.concatenate([one, np.array(ends)])
    # the first TOP points of a section lie on the upper, the last four go round the sole
    is_sole = np.concatenate([column >= TOP - 1, np.tile(np.arange(1, around - 1) >= TOP - 1, 2)])
    tris = np.concatenate([tris, tris + count * around]).astype(np.int32)
    layer = np.tile(is_sole, 2).astype(np.int32)
    weights = np.concatenate([w for _, _, w in parts])
    index = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    best = np.take_along_axis(weights, index, axis=1)
    uv = np.full((len(tris), 3, 2), 0.5, dtype=np.float32)
    return Mesh(
        points, tris, uv, layer, (upper, sole), index, best / best.sum(axis=1, keepdims=True), np.zeros(len(points))
    )


def _loft(body: Body, side: str) -> tuple[np.ndarray, int, np.ndarray]:
    """Points [SLICES * N, 3], N, and bone weights of one shoe."""
    ankle = body.pivot(side + "foot")
    top = ankle[2] + 0.010
    foot = (body.bone(side + "foot", side + "toes", side + "shin") > 0.5) & (body.vertices[:, 2] < top)
    v = body.vertices[foot]
    spread = v[:, :2] - v[:, :2].mean(axis=0)
    ahead = np.linalg.svd(spread, full_matrices=False)[2][0]
    ahead = ahead if ahead[0] > 0 else -ahead
    across = np.array([-ahead[1], ahead[0]])
    t, s = v[:, :2] @ ahead, v[:, :2] @ across
    first, last = t.min() - 0.006, t.max() + 0.010
    at = first + (last - first) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, SLICES)))
    low, high, up = (_profile(at, t, x, f) for x, f in ((s, np.min), (s, np.max), (v[:, 2], np.max)))
    from_end = np.minimum((at - first) / 0.035, (last - at) / 0.055)
    round_off = np.sqrt(np.clip(1.0 - (1.0 - np.clip(from_end, 0.0, 1.0)) ** 2, 0.0, 1.0))
    half = (0.5 * (high - low) + _LEATHER) * np.maximum(round_off, 0.02)
    middle = 0.5 * (high + low)
    ceiling = np.maximum(np.minimum(up, top) + _LEATHER, 0.045) * (0.45 + 0.55 * round_off)
    angle = np.linspace(0.0, np.pi, TOP)
    wide = np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.55
    tall = np.sin(angle) ** 0.65
    # a tall section narrows towards the ankle; the sole stands out by 3 mm
    narrow = 1.0 - 0.22 * np.clip((ceiling[:, None] - 0.05) / 0.05, 0.0, 1.0) * tall[None]
    sections_s = (
        np.concatenate(
            [half[:, None] * wide * narrow, (half + 0.003)[:, None] * np.array([-1.0, -0.97, 0.97, 1.0])], axis=1
        )
        + middle[:, None]
    )
    sections_z = np.concatenate(
        [0.002 + ceiling[:, None] * tall, np.tile([0.001, -SOLE, -SOLE, 0.001], (SLICES, 1))], axis=1
    )
    xy = at[:, None, None] * ahead + sections_s[..., None] * across
    points = np.concatenate([xy, sections_z[..., None]], axis=-1).reshape(-1, 3)
    weights = np.zeros((len(points), len(BONES)))
    toe = np.clip(((points[:, :2] - body.pivot(side + "toes")[:2]) @ ahead) / 0.03 + 0.5, 0.0, 1.0)
    weights[:, BONES.index(side + "toes")], weights[:, BONES.index(side + "foot")] = toe, 1.0 - toe
    return points, sections_s.shape[1], weights


def _profile(at: np.ndarray, t: np.ndarray, values: np.ndarray, pick: object) -> np.ndarray:
    """Extreme of some values along the foot, within 12 mm of each place, smoothed over 2 cm."""
    found = np.array([pick(values[np.abs(t - x) <= max(0.012, np.abs(t - x).min() + 1e-9)]) for x in at])  # type: ignore[operator]
    kernel = np.exp(-0.5 * ((at[:, None] - at[None]) / 0.012) ** 2)
    return kernel @ found / kernel.sum(axis=1)
