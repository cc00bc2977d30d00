"""The baked bodies: reading them, and where on a body a point lies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from posegaussian.stages.simulator.subjects.skeleton import BONES, CARRIERS, SIDES

FOLDER = Path(__file__).parent
EYE_VERTICES = 144
"""The last vertices of a body are its two eyeballs."""


@dataclass(frozen=True, eq=False)
class Body:
    """A naked body at rest: feet at z = 0, facing +x, left is +y, metres."""

    vertices: np.ndarray
    """[V, 3]."""
    tris: np.ndarray
    """[T, 3] int64."""
    uv: np.ndarray
    """[T, 3, 2] in 0..1."""
    weights: np.ndarray
    """[V, B] share of every bone, sums to 1."""
    pivots: np.ndarray
    """[B, 3] where each bone turns."""
    joints: np.ndarray
    """[17, 3] COCO-17."""

    def bone(self, *names: str) -> np.ndarray:
        """[V] share of some bones together."""
        return self.weights[:, [BONES.index(n) for n in names]].sum(axis=1)

    def pivot(self, name: str) -> np.ndarray:
        """[3] where a bone turns."""
        return self.pivots[BONES.index(name)]

    @cached_property
    def arms(self) -> np.ndarray:
        """[V] share of the arm bones from the upper arm on."""
        return self.bone(*(s + b for s in SIDES for b in ("upper_arm", "forearm", "hand")))

    @cached_property
    def edges(self) -> np.ndarray:
        """[E, 2] unique pairs of neighbouring vertices."""
        pairs = np.sort(np.concatenate([self.tris[:, [0, 1]], self.tris[:, [1, 2]], self.tris[:, [2, 0]]]), axis=1)
        return np.unique(pairs, axis=0)

    def along(self, chain: tuple[str, str, str]) -> np.ndarray:
        """[V] metres along a limb from its first pivot, of the nearer side: an elbow lies where the first bone ends.

        chain: three bones, for example thigh, shin, foot. Vertices that do not follow them have -1.
        """
        out = np.full(len(self.vertices), -1.0)
        for side in SIDES:
            first, second, end = (self.pivot(side + b) for b in chain)
            share = self.bone(*(side + b for b in chain), *([side + "toes"] if chain[2] == "foot" else []))
            a, b = second - first, end - second
            near = (self.vertices - first) @ a / np.linalg.norm(a)
            far = np.linalg.norm(a) + (self.vertices - second) @ b / np.linalg.norm(b)
            # one bone after the other, changing over where the two measures agree: at the bend
            limb = np.where(
                self.bone(side + chain[0]) > self.bone(side + chain[1], side + chain[2]),
                np.minimum(near, np.linalg.norm(a)),
                np.maximum(far, np.linalg.norm(a)),
            )
            out = np.where(share > 0.5, limb, out)
        return out

    def limb_length(self, chain: tuple[str, str, str], share: float) -> float:
        """Metres along a limb: 1 ends at the second pivot, 2 at the third."""
        first, second, end = (self.pivot("left_" + b) for b in chain)
        lengths = (np.linalg.norm(second - first), np.linalg.norm(end - second))
        return float(min(share, 1.0) * lengths[0] + max(share - 1.0, 0.0) * lengths[1])

    @cached_property
    def joint_radius(self) -> np.ndarray:
        """[17] metres from each joint to the nearest skin that follows its bone."""
        out = np.empty(len(self.joints))
        for j, (joint, bone) in enumerate(zip(self.joints, CARRIERS, strict=True)):
            own = self.weights[:, bone] > 0.3
            out[j] = np.linalg.norm(self.vertices[own] - joint, axis=1).min()
        return out


@lru_cache(maxsize=16)
def load_body(name: str) -> Body:
    """A baked subject. Raises KeyError for a name that has no file."""
    file = FOLDER / f"{name}.npz"
    if not file.is_file():
        raise KeyError(
            f"no baked subject {name!r}; there are"
            f" {', '.join(sorted(f.stem for f in FOLDER.glob('*.npz') if f.stem != 'body'))}"
        )
    shared, own = np.load(FOLDER / "body.npz"), np.load(file)
    weights = np.zeros((len(shared["bones"]), len(BONES)))
    np.put_along_axis(weights, shared["bones"].astype(np.int64), shared["weights"] / 255.0, axis=1)
    vertices = own["vertices"] / 65535.0 * own["span"] + own["low"]
    uv = (shared["uv"] / 65535.0)[shared["corners"].astype(np.int64)]
    return Body(vertices, shared["faces"].astype(np.int64), uv, weights, own["pivots"], own["joints"])
