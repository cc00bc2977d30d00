"""By which small turns of cameras what pairs of them both see comes to lie on each other's epipolar lines.

A camera that is written down turned, or moved sideways, by a little sees its subject shifted: at one distance both look
alike, and a turn undoes either. What two cameras both see, points of the surface or of two outlines, lies in one plane
with their centres; where it misses it, Gauss-Newton steps turn the cameras until it does not, with robust weights. What
no pair can tell, such as a turn of both about their baseline, stays as it is written, and so does where the subject
lies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.storage.model.cameras import Rig, rigid, rotation_matrix

LINKS = "survey/links"
"""[V, V, POINTS, 4]: x, y at z = 1 of what a source view and each later one both see, in either's axes; 0 for none."""
KINDS = ("outlines", "features")
"""What is seen by two cameras, in the order of the links."""
MOST = 12
"""Points of a kind that are kept of a pair."""
POINTS = len(KINDS) * MOST
SCATTER = np.repeat([0.3, 0.5], MOST)
"""By how much a link misses its line though the cameras stand right, of a picture of `SIDE` px: masks end at whole
pixels, and a feature of a turned surface is found elsewhere."""
SIDE = 512.0
APART = 2.0
"""Px of such a picture from which on a silhouette that no turn makes fit the others is of a wrong camera."""
WRITTEN, LEAST = 2.0, 1e-3
"""Times the median by which links miss their lines, and least px: by so much cameras that are written down may be off,
one standard deviation an axis; what links do not tell stays within it."""
HELD = 1e4
"""By how much more tightly they are held against turning all together after a subject that is shifted. Links hardly
tell that: left free it lay 0.24 px beside its place on the mean of 22 simulated captures, exact ones and such that were
off by 0.3 to 1 px, up to 0.54 where masks have loose hair; as they are written down, 0.21."""
ROBUST = 2.0
"""Scatters from which on a link counts less (Huber)."""
STEPS = 8
"""Steps; from 3 px off it takes four."""


@dataclass(frozen=True, eq=False)
class Links:
    """What pairs of cameras both see, as directions in the axes of the cameras as they are written down."""

    views: np.ndarray
    """[n, 2] int: the two cameras."""
    first: np.ndarray
    """[n, 3] (x, y, 1) in the first one's axes."""
    second: np.ndarray
    """[n, 3] in the second one's."""
    scatter: np.ndarray
    """[n] px of a picture of `SIDE` px."""
    kind: np.ndarray
    """[n] int: index in `KINDS`."""

    @classmethod
    def of(cls, noted: np.ndarray) -> Links:
        """Of `survey/links` [S, S, POINTS, 4] among S cameras: x, y in the first and in the second; all 0 for none."""
        noted = np.asarray(noted, dtype=np.float64)
        a, b, point = np.nonzero(noted.any(axis=-1))
        seen = noted[a, b, point]
        one = np.ones((len(seen), 1))
        return cls(
            np.stack([a, b], axis=1),
            np.concatenate([seen[:, :2], one], axis=1),
            np.concatenate([seen[:, 2:], one], axis=1),
            SCATTER[point],
            point // MOST,
        )

    def missed(self, rig: Rig) -> np.ndarray:
        """[n] px of `rig`, signed, by which they miss each other's lines: Sampson's distance (Hartley and Zisserman,
        11.4.3)."""
        return self._missed(rig)[0]

    def medians(self, rig: Rig) -> dict[str, float]:
        """{kind: median px of `rig` by which links miss their lines}, of the kinds that there are."""
        off = np.abs(self.missed(rig))
        return {k: float(np.median(off[self.kind == i])) for i, k in enumerate(KINDS) if (self.kind == i).any()}

    def _missed(self, rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """[n] px, and their slopes [n, 3] by a turn of the first and of the second camera, px a radian."""
        (a, b), rotations = self.views.T, rig.rotations
        x, y = (np.einsum("nji,nj->ni", rotations[v], d) for v, d in ((a, self.first), (b, self.second)))
        baseline = rig.centres[b] - rig.centres[a]
        # y . (baseline x x) = 0; in the axes of a camera its plane's normal is the line, seen through its intrinsics.
        planes = (a, np.cross(y, baseline)), (b, np.cross(baseline, x))
        normals = [np.einsum("nij,nj->ni", rotations[v], n) for v, n in planes]
        inverse = np.linalg.inv(rig.intrinsics)
        lines = [np.einsum("nji,nj->ni", inverse[v], n)[:, :2] for v, n in zip((a, b), normals, strict=True)]
        slope = np.sqrt(sum((line**2).sum(axis=1) for line in lines))
        slope = np.where(slope > 0, slope, np.inf)[:, None]
        product = (y * np.cross(baseline, x)).sum(axis=1, keepdims=True)
        # A camera turned by w sees the world's direction of a pixel d turned by -w: R^T (d - w x d).
        by_turn = [np.cross(d, n) / slope for d, n in zip((self.first, self.second), normals, strict=True)]
        return (product / slope)[:, 0], -by_turn[0], -by_turn[1]


def fitted_turns(rig: Rig, links: Links) -> np.ndarray:
    """[S, 3] rad: the turns, in each camera's axes, that fit the links best and are no larger than these ask for."""
    count, pixel = len(rig), float(rig.size.max()) / SIDE
    turns = np.zeros((count, 3))
    if not len(links.views):
        return turns
    off_now = max(LEAST * pixel, WRITTEN * float(np.median(np.abs(links.missed(rig)))))
    written = off_now / rig.intrinsics[:, 0, 0]
    linked = np.isin(np.arange(count), links.views)
    together = following(rig, linked)
    tightness = np.diag(np.repeat(written**-2, 3)) + HELD * written.mean() ** -2 * together @ together.T
    one, other = ((3 * v[:, None] + np.arange(3)) for v in links.views.T)
    columns = np.concatenate([one, other], axis=1)
    for _ in range(STEPS):
        off, by_first, by_second = links._missed(turned(rig, turns))
        scaled = off / (links.scatter * pixel)
        slopes = np.concatenate([by_first, by_second], axis=1) / (links.scatter * pixel)[:, None]
        weights = np.minimum(1.0, ROBUST / np.maximum(np.abs(scaled), 1e-12))
        normal, right = tightness.copy(), -tightness @ turns.ravel()
        np.add.at(
            normal,
            (columns[:, :, None], columns[:, None, :]),
            weights[:, None, None] * slopes[:, :, None] * slopes[:, None, :],
        )
        np.add.at(right, columns, -(weights * scaled)[:, None] * slopes)
        turns = turns + np.linalg.solve(normal, right).reshape(count, 3)
    return turns


def following(rig: Rig, of: np.ndarray | None = None) -> np.ndarray:
    """[3 S, 3] orthonormal: turns of all cameras, or of those in `of` [S] bool, in their own axes, that follow shifts
    of the subject along the world's axes."""
    ahead = look_at_point(rig) - rig.centres
    follow = np.cross(ahead[:, None], np.eye(3)) / (ahead**2).sum(axis=1)[:, None, None]  # [S, shift, 3] world axes
    turns = np.einsum("sij,skj->sik", rig.rotations, follow)
    return np.linalg.qr(np.where(of.repeat(3)[:, None] if of is not None else True, turns.reshape(-1, 3), 0.0))[0]


def turned(rig: Rig, turns: np.ndarray) -> Rig:
    """The cameras turned about their centres by [S, 3] rad in their own axes."""
    poses = rig.world_to_camera.copy()
    for v in np.flatnonzero(np.asarray(turns).any(axis=1)):
        turn = rotation_matrix(turns[v])
        poses[v] = rigid(turn @ rig.rotations[v], turn @ rig.world_to_camera[v, :3, 3])
    return replace(rig, world_to_camera=poses)
