"""Robust triangulation of one frame's joints: all pairs of views, outlier rejection, weighted refinement.

A *track* is one detected person in one view; with one person a view, tracks are views. Everything is computed frame by
frame on arrays whose shapes do not depend on the partition, so that a partition's length cannot change a bit.

Linear step: direct linear transformation on normalised coordinates (Hartley and Zisserman, Multiple View Geometry,
12.2), inhomogeneous. Hypotheses are ranked by the truncated squared residual (MSAC: Torr and Zisserman 2000).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.points import NEAR, project, rays
from posegaussian.storage.model.cameras import Rig

MIN_ANGLE = np.deg2rad(1.0)
"""Two rays that meet under less than this say nothing about depth."""
BODIES = 5.0
"""Extents of a person in a picture that count as its longest side where they are shorter: who is small in a large
picture errs by few of its pixels, and left and right lie a few apart."""
FEWEST_TOLD = 4
"""Joints of a detection below which its box says nothing about the person's extent."""
MOST_PAIRS = 256
"""Pairs tried a frame; up to 23 tracks are searched exhaustively, more are thinned."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """T detected people of one frame, each in one view, with what triangulation needs of them."""

    views: np.ndarray
    """[T] int view of each track, an index into the rig."""
    pixels: np.ndarray
    """[T, J, 2] px of frames/*."""
    weights: np.ndarray
    """[T, J] score, 0 where the joint is missing or not believed."""
    directions: np.ndarray
    """[T, J, 3] unit viewing directions in the world."""
    normal: np.ndarray
    """[T, J, 4, 4] normal matrix of each detection's two linear equations on the homogeneous world point."""
    unit: np.ndarray
    """[T] px of which bounds on residuals are shares, see `unit_of`."""

    @classmethod
    def of(cls, rig: Rig, views: np.ndarray, joints: np.ndarray, min_score: float) -> Tracks:
        """From joints [T, J, 3] in pixels of `rig`; scores below `min_score` weigh nothing."""
        flat, directions = rays(rig, views, joints[..., :2])
        pose = rig.world_to_camera[views][:, None, None]
        rows = flat[..., None] * pose[..., 2, :] - pose[..., 0, :2, :]  # [T, J, 2, 4]: x r3 - r1, y r3 - r2
        weights = np.where(joints[..., 2] >= min_score, joints[..., 2], 0.0)
        normal = np.einsum("tjra,tjrb->tjab", rows, rows)
        return cls(views, joints[..., :2], weights, directions, normal, unit_of(rig, views, joints, min_score))


def unit_of(rig: Rig, views: np.ndarray, joints: np.ndarray, min_score: float) -> np.ndarray:
    """[T] px of which bounds on the residuals of detections [T, J, 3] in px of `rig` are shares: their picture's
    longest side, or `BODIES` times the diagonal of the box of the joints of at least `min_score` where that is less.

    A person whose box is a fifth of that side or more is judged by the picture alone.
    """
    told = joints[..., 2] >= min_score
    low, high = (
        pick(np.where(told[..., None], joints[..., :2], beyond), axis=1)
        for pick, beyond in ((np.min, np.inf), (np.max, -np.inf))
    )
    longest = rig.size[views].max(axis=-1).astype(np.float64)
    body = BODIES * np.linalg.norm(high - low, axis=-1)
    return np.where((told.sum(axis=1) >= FEWEST_TOLD) & (body > 0), np.minimum(body, longest), longest)


def pairs_of(views: np.ndarray) -> np.ndarray:
    """[P, 2] pairs of tracks that lie in different views, about `MOST_PAIRS` at most, every track in as many as any
    other.

    Pairs are (i, i + d) around the list, for all d, or for some spread from neighbours to opposites where all are too
    many.
    """
    count = len(views)
    shifts = np.arange(1, count // 2 + 1)
    if count * len(shifts) > MOST_PAIRS:
        shifts = np.unique(np.linspace(1, count // 2, max(1, MOST_PAIRS // count)).astype(np.int64))
    around = ((i, (i + int(d)) % count) for d in shifts for i in range(count))
    pairs = dict.fromkeys((min(p), max(p)) for p in around if views[p[0]] != views[p[1]])
    return np.array(list(pairs), dtype=np.int64).reshape(-1, 2)


def residuals(rig: Rig, tracks: Tracks, points: np.ndarray) -> np.ndarray:
    """World points [..., J, 3] -> distance [..., J, T] px to every track's detection.

    Infinite where the point is not in front of the track's camera.
    """
    pixels, depth = project(rig, points)
    off = pixels[..., tracks.views, :] - np.moveaxis(tracks.pixels, 0, 1)
    return np.where(depth[..., tracks.views] > NEAR, np.linalg.norm(off, axis=-1), np.inf)


def _solve(normal: np.ndarray) -> np.ndarray:
    """Points [..., 3] that minimise x^T N x over homogeneous x = (X, 1), for normal matrices [..., 4, 4]."""
    a = normal[..., :3, :3]
    tiny = 1e-12 * np.trace(a, axis1=-2, axis2=-1) + np.finfo(np.float64).tiny
    return np.linalg.solve(a + tiny[..., None, None] * np.eye(3), -normal[..., :3, 3:])[..., 0]


def meeting(tracks: Tracks, weights: np.ndarray) -> np.ndarray:
    """[J, 3] world points nearest to the rays of tracks of weights [J, T], in the linear sense; of a joint that fewer
    than two tracks see they mean nothing."""
    return _solve(np.einsum("jt,tjab->jab", weights, tracks.normal))


def hypotheses(rig: Rig, tracks: Tracks, pairs: np.ndarray, max_residual: float) -> tuple[np.ndarray, np.ndarray]:
    """For every pair [P, 2]: points [P, J, 3] and agreement [P, J, T] in 0..1 of every track with them.

    Agreement is score * (1 - min(r / max_residual, 1)^2), r a share of the track's unit; all zero for a
    joint that a track of the pair lacks, whose rays are nearly parallel, or that does not even fit the pair itself.
    """
    a, b = pairs.T
    points = _solve(tracks.normal[a] + tracks.normal[b])
    share = np.minimum(residuals(rig, tracks, points) / tracks.unit / max_residual, 1.0)
    agreement = tracks.weights.T * (1.0 - share**2)
    each = np.arange(len(pairs))
    sound = _wide(tracks, pairs) & (agreement[each, :, a] > 0) & (agreement[each, :, b] > 0)
    return points, agreement * sound[..., None]


def _wide(tracks: Tracks, pairs: np.ndarray) -> np.ndarray:
    """[P, J] whether the rays of a pair meet under more than `MIN_ANGLE`."""
    a, b = pairs.T
    return np.linalg.norm(np.cross(tracks.directions[a], tracks.directions[b]), axis=-1) > np.sin(MIN_ANGLE)


def _gauss_newton(rig: Rig, tracks: Tracks, weights: np.ndarray, points: np.ndarray, steps: int = 3) -> np.ndarray:
    """Refine points [J, 3] to the least weighted squared residual (weights [J, T]);
    a step that does not improve is not taken. Residuals are shares of each picture's longest side."""
    longest = rig.size[tracks.views].max(axis=-1)[:, None, None]

    def cost(p: np.ndarray) -> np.ndarray:
        r = np.where(weights > 0, residuals(rig, tracks, p) / longest[:, 0, 0], 0.0)
        return (weights * r**2).sum(-1)

    k, pose = rig.intrinsics[tracks.views], rig.world_to_camera[tracks.views]
    best = cost(points)
    for _ in range(steps):
        camera = np.einsum("tij,nj->nti", pose[:, :3, :3], points) + pose[:, :3, 3]
        z = np.where(camera[..., 2] > NEAR, camera[..., 2], 1.0)[..., None, None]
        flat = np.concatenate([camera[..., :2] / z[..., 0], np.ones_like(camera[..., :1])], axis=-1)
        off = (np.einsum("tij,ntj->nti", k[:, :2], flat) - np.moveaxis(tracks.pixels, 0, 1)) / longest[..., 0]
        # d(K flat)/dX = K (I - flat e3^T) R / z
        jacobian = (
            np.einsum("tij,ntjk->ntik", k[:, :2], pose[:, :3, :3] - flat[..., None] * pose[:, 2:3, :3]) / z / longest
        )
        a = np.einsum("nt,ntij,ntik->njk", weights, jacobian, jacobian)
        g = np.einsum("nt,ntij,nti->nj", weights, jacobian, off)
        tiny = 1e-12 * np.trace(a, axis1=-2, axis2=-1) + np.finfo(np.float64).tiny
        moved = points - np.linalg.solve(a + tiny[:, None, None] * np.eye(3), g[..., None])[..., 0]
        now = cost(moved)
        better = now < best
        points, best = np.where(better[:, None], moved, points), np.where(better, now, best)
    return points


def triangulate(rig: Rig, joints: np.ndarray, min_score: float, max_residual: float) -> np.ndarray:
    """Joints [V, J, 3] (u, v, score) of one frame in pixels of `rig` (no lens) -> [J, 4] (x, y, z, score), world
    metres.

    A joint is known when at least two views under an angle agree within `max_residual` (a share, see `unit_of`) on a
    point in front of them; else it is all zeros. Score: the sum of the agreeing views' scores over the number of views
    that saw the joint, that is mean inlier score times inlier share.
    """
    views, count = np.arange(len(rig)), joints.shape[1]
    pairs = pairs_of(views)
    if not len(pairs):
        return np.zeros((count, 4))
    tracks = Tracks.of(rig, views, joints, min_score)
    points, agreement = hypotheses(rig, tracks, pairs, max_residual)
    best = agreement.sum(-1).argmax(axis=0)  # the first of equals: deterministic
    points, inlier = points[best, np.arange(count)], agreement[best, np.arange(count)] > 0
    seen = tracks.weights.T > 0
    for _ in range(2):
        weights = tracks.weights.T * inlier
        linear = meeting(tracks, weights)
        worst = np.where(inlier, residuals(rig, tracks, linear), 0.0).max(-1, keepdims=True)
        points = _gauss_newton(rig, tracks, weights, np.where(worst < np.inf, linear, points))
        inlier = seen & (residuals(rig, tracks, points) / tracks.unit < max_residual)
    a, b = pairs.T
    known = (_wide(tracks, pairs) & inlier.T[a] & inlier.T[b]).any(axis=0)
    score = (tracks.weights.T * inlier).sum(-1) / np.maximum(seen.sum(-1), 1)
    return np.where(known[:, None], np.concatenate([points, score[:, None]], axis=-1), 0.0)
