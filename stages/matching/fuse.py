"""One depth and one confidence a view, from what its pairs found."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.matching.sampling import fill
from posegaussian.storage.model.cameras import Rig, to_integer_centres

MATCHED = 0.5
"""Least confidence of a pixel whose match holds in both directions."""
FILLED = 0.4
"""Confidence of a pixel filled from matched neighbours."""
HULL = 0.3
"""Confidence of a pixel that has the hull's surface alone."""
TRUST = 0.9
"""Belief in a single match without any disagreement."""


def transfer(rig: Rig, source: int, target: int) -> np.ndarray:
    """[3, 4] from (x z, y z, z, 1) of one view to homogeneous pixels of another, integer centres in both."""
    into = rig.world_to_camera[target] @ np.linalg.inv(rig.world_to_camera[source])
    from_k, to_k = to_integer_centres(rig.intrinsics[source]), to_integer_centres(rig.intrinsics[target])
    return np.concatenate([to_k @ into[:3, :3] @ np.linalg.inv(from_k), to_k @ into[:3, 3:]], axis=1)


@compiled
def fuse(
    depths: np.ndarray, errors: np.ndarray, focal_baselines: np.ndarray, consistency: float
) -> tuple[np.ndarray, np.ndarray]:
    """Depth [h, w] and confidence [h, w], float32, from K candidates [K, h, w] and their disagreement in px [K, h, w].

    A candidate counts when its disagreement is at most `consistency` px; its weight is exp(-2 (error / consistency)^2).
    The best candidate and those within `consistency` px of it are averaged in inverse depth. Confidence is 1/2 plus
    half of the belief 1 - prod(1 - 0.9 weight); a candidate that counts but contradicts the best one multiplies the
    belief by 1/2.
    """
    count, height, width = depths.shape
    depth, confidence = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            best = -1
            for k in range(count):
                if errors[k, i, j] <= consistency and (best < 0 or errors[k, i, j] < errors[best, i, j]):
                    best = k
            if best < 0:
                continue
            total, weights, doubt, contradicted = 0.0, 0.0, 1.0, 1.0
            for k in range(count):
                if errors[k, i, j] > consistency:
                    continue
                apart = abs(1 / depths[k, i, j] - 1 / depths[best, i, j]) * focal_baselines[k]
                if apart > consistency:
                    contradicted *= 0.5
                    continue
                weight = np.exp(-2 * (errors[k, i, j] / consistency) ** 2)
                total += weight / depths[k, i, j]
                weights += weight
                doubt *= 1 - TRUST * weight
            depth[i, j] = weights / total
            confidence[i, j] = MATCHED + (1 - MATCHED) * (1 - doubt) * contradicted
    return depth, confidence


def complete(
    depth: np.ndarray, confidence: np.ndarray, near: np.ndarray, far: np.ndarray, surface: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and confidence [h, w] with the gaps inside the hull filled: from matched neighbours, else the hull's
    `surface` [h, w], which is its near end unless given.

    `near` and `far` [h, w] are the hull's depths, 0 outside; filled values are clamped to them.
    """
    hull = near > 0
    inverse = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0).astype(np.float32)
    guessed = fill(inverse, hull)
    gap, reached = hull & (depth == 0), guessed > 0
    filled = np.clip(1 / np.where(reached, guessed, 1), near, far)
    out = np.where(gap, np.where(reached, filled, near if surface is None else surface), depth).astype(np.float32)
    trust = np.where(gap, np.where(reached, FILLED, HULL), confidence).astype(np.float32)
    return out, trust
