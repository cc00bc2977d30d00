"""Studios are not empty: a post between cameras and subject hides part of it from some of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above


class OccludingObject(EffectParams):
    """A post."""

    position: tuple[float, float] = Field((0.9, 0.45), description="Where it stands, metres.")
    radius: float = Field(0.03, gt=0, le=5, description="Metres.")
    height: float = Field(1.2, gt=0, le=10, description="Metres.")


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    p = evidence.params
    return above(
        p.radius, bound, f"a post of {2 * p.radius:g} x {p.height:g} m stands at ({p.position[0]:g}, {p.position[1]:g})"
    )


def apply(params: Any, seed: int) -> Any:
    """The post as a `take.Actor` that stands still."""
    from posegaussian.stages.simulator.render.mesh import Mesh, Texture
    from posegaussian.stages.simulator.wardrobe.actors import Still

    n = 48
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.stack(
        [params.position[0] + params.radius * np.cos(angle), params.position[1] + params.radius * np.sin(angle)], axis=1
    )
    levels = np.linspace(0.0, params.height, 9)
    points = np.concatenate(
        [np.column_stack([ring, np.full(n, z)]) for z in levels] + [[[*params.position, params.height]]]
    )
    grid = np.arange(n * len(levels)).reshape(-1, n)
    a, b, c, d = grid[:-1], np.roll(grid[:-1], -1, axis=1), grid[1:], np.roll(grid[1:], -1, axis=1)
    top = np.stack([grid[-1], np.roll(grid[-1], -1), np.full(n, len(points) - 1)], axis=-1)
    tris = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (b, d, c))] + [top]).astype(
        np.int32
    )
    paint = Texture(np.full((1, 1, 3), 0.22, np.float32) * np.array([1.0, 0.8, 0.45], np.float32), 0.04)
    still = np.zeros((len(points), 4))
    still[:, 0] = 1.0
    return Still(
        Mesh(
            points,
            tris,
            np.full((len(tris), 3, 2), 0.5, np.float32),
            np.zeros(len(tris), np.int32),
            (paint,),
            np.zeros((len(points), 4), np.int64),
            still,
            np.zeros(len(points)),
        )
    )


EFFECT = SceneEffect(
    Effect("occluding_object", "Put a post between cameras and subject.", "radius of the post", 0.0, "m", _decide),
    OccludingObject,
    "meshes",
    "posegaussian.stages.simulator.effects.occluding_object:apply",
    6.0,
)
