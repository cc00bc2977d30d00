"""Which poses of the cameras would fit the joints best? Where they lie elsewhere than the calibration says, it is the
calibration.

A detector's scatter averages out over frames and joints; an error of a pose moves all joints of a camera together.
Bundle adjustment (Triggs et al., "Bundle adjustment, a modern synthesis", 2000) of all poses and points, intrinsics
kept, with the points eliminated (Schur complement) and robust weights. The seven freedoms of the whole rig (where the
world is and how large) stay as they are: the normal equations are solved with the least step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.geometry.points import NEAR
from posegaussian.storage.model.cameras import Rig, rigid, rotation_matrix

STEPS = 12
"""Steps; the residual stays the same after six or so."""
FEWEST = 60
"""Joints of a camera without which its pose is not asked for."""


@dataclass(frozen=True, eq=False)
class Refit:
    """Poses that fit the joints, beside those of the calibration."""

    rig: Rig
    """The cameras, moved."""
    points: np.ndarray
    """[N, 3] joints in space."""
    seen: np.ndarray
    """[N, V] bool: which camera saw which joint."""
    before: float
    """Px: median residual with the calibration."""
    after: float
    """Px: median residual with the moved cameras."""


def refit(rig: Rig, seen: np.ndarray, space: np.ndarray) -> Refit | None:
    """From joints seen [F, V, J, 3] px of `rig` (score 0 = unknown) and in space [F, J, 4];
    None where a camera saw too few."""
    known = space[..., 3] > 0
    observed = np.moveaxis(seen, 1, 2)[known]
    points, valid = space[known][:, :3], observed[..., 2] > 0
    if len(rig) < 2 or not len(points) or valid.sum(axis=0).min() < FEWEST:
        return None
    poses, moved, before, after = rig.world_to_camera.copy(), points, 0.0, 0.0
    for step in range(STEPS + 1):
        offsets, camera = _offsets(rig, poses, moved, observed[..., :2])
        distance = np.linalg.norm(offsets, axis=-1)
        there = valid & (camera[..., 2] > NEAR)
        after = float(np.median(distance[there]))
        before = after if step == 0 else before
        if step == STEPS:
            break
        # Huber: what lies farther than the scatter counts as if it lay there. 1e-6 px: joints without any error.
        weights = there * np.minimum(1.0, max(1.4826 * after, 1e-6) / np.maximum(distance, 1e-9))
        turns, shifts, steps = _step(rig, poses, camera, offsets, weights)
        for v in range(len(rig)):
            turn = rotation_matrix(turns[v])
            poses[v] = rigid(turn @ poses[v, :3, :3], turn @ poses[v, :3, 3] + shifts[v])
        moved = moved + steps
    return Refit(replace(rig, world_to_camera=poses), moved, valid, before, after)


def pair_error(rig: Rig, found: Refit, first: int, second: int) -> tuple[float, float]:
    """Px by which the calibration's epipolar lines miss the joints of two cameras, scatter taken out: median and its
    standard error.

    Of the joints that both see, as the moved cameras show them: those fit each other exactly.
    """
    both = found.seen[:, first] & found.seen[:, second]
    if not both.any():
        return 0.0, np.inf
    pixels = [
        _offsets(found.rig, found.rig.world_to_camera, found.points[both], np.zeros((int(both.sum()), len(rig), 2)))[0][
            :, v
        ]
        for v in (first, second)
    ]
    off = np.abs(signed_epipolar_distance(fundamental(rig, first, second), -pixels[0], -pixels[1]))
    # Six freedoms of a pose from 2 n coordinates of scatter `after`
    # (the median of a distance is 1.18 standard deviations).
    return float(np.median(off)), found.after / 1.18 * float(np.sqrt(3 / both.sum()))


def _offsets(rig: Rig, poses: np.ndarray, points: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [N, V, 2] less the projections of points [N, 3], and the points in camera axes [N, V, 3]."""
    camera = np.einsum("vij,nj->nvi", poses[:, :3, :3], points) + poses[:, :3, 3]
    depth = np.where(camera[..., 2] > NEAR, camera[..., 2], 1.0)
    return pixels - np.einsum("vij,nvj->nvi", rig.intrinsics[:, :2], camera / depth[..., None]), camera


def _step(
    rig: Rig, poses: np.ndarray, camera: np.ndarray, offsets: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One Gauss-Newton step: turns [V, 3] rad and shifts [V, 3] m in camera axes, and moves of the points [N, 3] m."""
    views = len(rig)
    depth = np.where(camera[..., 2] > NEAR, camera[..., 2], 1.0)
    flat = camera / depth[..., None]
    # d(K flat)/dc = K (I - flat e3^T) / z
    along = (
        np.einsum("vij,nvjk->nvik", rig.intrinsics[:, :2], np.eye(3) - flat[..., :, None] * np.eye(3)[2])
        / depth[..., None, None]
    )
    by_pose = np.concatenate([-np.einsum("nvij,nvjk->nvik", along, _cross(camera)), along], axis=-1)
    by_point = np.einsum("nvij,vjk->nvik", along, poses[:, :3, :3])
    of_poses = np.einsum("nv,nvia,nvib->vab", weights, by_pose, by_pose)
    of_points = np.einsum("nv,nvia,nvib->nab", weights, by_point, by_point)
    of_both = np.einsum("nv,nvia,nvib->nvab", weights, by_pose, by_point)
    right_pose = np.einsum("nv,nvia,nvi->va", weights, by_pose, offsets)
    right_point = np.einsum("nv,nvia,nvi->na", weights, by_point, offsets)
    tiny = 1e-9 * np.trace(of_points, axis1=1, axis2=2)[:, None, None] + 1e-12
    inverse = np.linalg.inv(of_points + tiny * np.eye(3))
    carried = np.einsum("nvab,nbc->nvac", of_both, inverse)
    reduced = -np.einsum("nvac,nwbc->vawb", carried, of_both)
    reduced[np.arange(views), :, np.arange(views), :] += of_poses
    right = right_pose - np.einsum("nvac,nc->va", carried, right_point)
    # The seven freedoms of the rig have no weight: the least-norm solution leaves them alone.
    solved = np.linalg.lstsq(reduced.reshape(6 * views, 6 * views), right.ravel(), rcond=1e-8)[0].reshape(views, 6)
    points = np.einsum("nab,nb->na", inverse, right_point - np.einsum("nvab,va->nb", of_both, solved))
    return solved[:, :3], solved[:, 3:], points


def _cross(v: np.ndarray) -> np.ndarray:
    """[..., 3] -> [..., 3, 3] with `_cross(v) w` = v x w."""
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    return np.stack(
        [np.stack([o, -z, y], axis=-1), np.stack([z, o, -x], axis=-1), np.stack([-y, x, o], axis=-1)], axis=-2
    )
