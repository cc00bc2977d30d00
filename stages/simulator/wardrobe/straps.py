"""Straps: bands over the clothes, a sash, a harness, a belt, bands around thighs and forearms, with buckles."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from posegaussian.stages.simulator.render.mesh import Mesh, Texture
from posegaussian.stages.simulator.render.raster import vertex_normals
from posegaussian.stages.simulator.subjects.bodies import Body
from posegaussian.stages.simulator.subjects.shells import Shell, cut, linear
from posegaussian.stages.simulator.subjects.skeleton import BONES, SIDES
from posegaussian.stages.simulator.wardrobe.description import Strap
from posegaussian.stages.simulator.wardrobe.folds import ROUNDS, quartered, quartered_places, shares_of, with_middles
from posegaussian.stages.simulator.wardrobe.materials import MATERIALS

THICK, BUCKLE = 0.006, 0.009
"""Metres that leather and buckles stand above the cloth."""
OVER = 0.003
"""Metres that a strap stands above the one named before it, where they cross."""
PRESSED = 0.025
"""Metres beside a strap over which folds rise again."""
_STEEL = (176, 172, 160)


def _share(weights: np.ndarray, *names: str) -> np.ndarray:
    return weights[:, [BONES.index(n) for n in names]].sum(axis=1)


def _on_trunk(weights: np.ndarray) -> np.ndarray:
    return _share(weights, *(s + b for s in SIDES for b in ("upper_arm", "forearm", "hand"))) < 0.4


def _waist(body: Body) -> float:
    return float(body.pivot("left_thigh")[2]) + 0.065


def band(body: Body, strap: Strap, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """[N] metres inside a strap, at points [N, 3] of a body at rest that follow bones with weights [N, B]; negative
    outside."""
    half, z = 0.5 * strap.width, points[:, 2]
    if strap.kind in ("thighs", "bracers"):
        first, last, at, wide = (
            ("thigh", "shin", 0.45, half) if strap.kind == "thighs" else ("forearm", "hand", 0.55, 4.0 * half)
        )
        out = np.full(len(points), -1.0)
        for side in SIDES:
            a, b = body.pivot(side + first), body.pivot(side + last)
            t = (points - a) @ (b - a) / np.linalg.norm(b - a)
            inside = np.minimum(wide, 0.45 * np.linalg.norm(b - a)) - np.abs(t - at * np.linalg.norm(b - a))
            out = np.where(_share(weights, side + first) > 0.5, inside, out)
        return out
    if strap.kind == "belt":
        inside = half - np.abs(z - _waist(body))
    elif strap.kind == "sash":
        top, low = _sash(body)
        along = (low - top) / np.linalg.norm(low - top)
        inside = half - np.abs((points[:, 1:] - top) @ np.array([-along[1], along[0]]))
    else:
        apart = 0.5 * body.pivot("left_upper_arm")[1]
        inside = np.maximum(
            np.minimum(half - np.abs(np.abs(points[:, 1]) - apart), z - _waist(body)), half - np.abs(z - _chest(body))
        )
    return np.where(_on_trunk(weights), inside, -1.0)


def _sash(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """[2] and [2] (y, z) of the left shoulder and the right hip."""
    shoulder, hip = body.pivot("left_upper_arm"), body.pivot("right_thigh")
    return np.array([0.55 * shoulder[1], shoulder[2]]), np.array([1.15 * hip[1], hip[2] + 0.08])


def _chest(body: Body) -> float:
    return float(0.45 * body.pivot("chest")[2] + 0.55 * body.pivot("left_upper_arm")[2])


def _buckle(body: Body, strap: Strap) -> np.ndarray:
    """[V] metres inside the buckle of a strap, in front."""
    middle = {
        "belt": (0.0, _waist(body)),
        "harness": (0.0, _chest(body)),
        "sash": tuple(0.5 * (_sash(body)[0] + _sash(body)[1])),
    }.get(strap.kind)
    if middle is None:
        return np.full(len(body.vertices), -1.0)
    y, z = np.abs(body.vertices[:, 1] - middle[0]), np.abs(body.vertices[:, 2] - middle[1])
    inside = np.minimum(0.75 * strap.width - y, 0.65 * strap.width - z)
    return np.where((body.vertices[:, 0] > 0.0) & _on_trunk(body.weights), inside, -1.0)


def strapped(body: Body, strap: Strap, place: int, worn: tuple[Shell, ...]) -> list[Mesh]:
    """A strap and its buckle, over what is worn, the uppermost last, and over skin where that is bare; `place` counts
    the straps below it."""
    base, slack = body.vertices, np.zeros(len(body.vertices))
    for under in worn:
        on = under.inside > 0.0
        base, slack = np.where(on[:, None], under.vertices, base), np.where(on, under.slack, slack)
    out, near = vertex_normals(base, body.tris), band(body, strap, body.vertices, body.weights) > -0.08
    fine, base, slack, out = _finely(body, near, base, slack, out)
    made = MATERIALS[strap.material]
    parts = (
        (band(fine, strap, fine.vertices, fine.weights), THICK, strap.color, made),
        (_buckle(fine, strap), BUCKLE, _STEEL, MATERIALS["metal"]),
    )
    return [
        cut(
            fine,
            Shell(base + (height + OVER * place) * out, inside, slack),
            Texture(np.broadcast_to(linear(c), (1, 1, 3)).astype(np.float32), m.gloss, m.exponent, m.sheen),
        )
        for inside, height, c, m in parts
        if (inside > 0).any()
    ]


def _finely(body: Body, near: np.ndarray, *values: np.ndarray) -> tuple[Any, ...]:
    """The triangles of a body with a vertex that is near, twice as four each, and values of its vertices: edges of a
    strap are cut straight through triangles, and those of the body are as long as a strap is wide."""
    kept = near[body.tris].any(axis=1)
    tris, uv, points, weights = body.tris[kept], body.uv[kept], body.vertices, body.weights
    for _ in range(ROUNDS):
        edges, tris = quartered(tris, len(points))
        uv = quartered_places(uv)
        points, weights, *values = (with_middles(v, edges) for v in (points, weights, *values))  # type: ignore[assignment]
    return dataclasses.replace(body, vertices=points, tris=tris, uv=uv, weights=weights), *values


def unpressed(body: Body, straps: tuple[Strap, ...], mesh: Mesh) -> np.ndarray:
    """[V] 0 where a strap lies on a garment and presses its folds flat, 1 beside."""
    out, weights = np.ones(len(mesh.vertices)), shares_of(mesh)
    for strap in straps:
        out *= np.clip(-band(body, strap, mesh.vertices, weights) / PRESSED - 0.3, 0.0, 1.0)
    return out
