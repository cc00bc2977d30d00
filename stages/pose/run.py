"""The pose kernel: the subject's joints in the source views, triangulated,
fill every view by reprojection, draw heatmaps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED, JOINTS3D, SEGMENTED, SINGLE_SOURCE, TRACKED, Facts
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.geometry.points import NEAR, focus, project
from posegaussian.stages.geometry.triangulation import unit_of
from posegaussian.stages.pose.facts import HIDDEN, POSE_HEATMAPS
from posegaussian.stages.pose.heatmaps import draw, grid_of
from posegaussian.stages.pose.jumps import jumps_told
from posegaussian.stages.pose.model_maps import put_model_maps
from posegaussian.stages.pose.params import PoseParams, uses_model_maps
from posegaussian.stages.pose.subject_detections import joint_set_of, subject_told
from posegaussian.stages.pose.subject_match import (
    found_subject,
    held_subject,
    hidden_subject,
    hidden_told,
    nobody_else,
)
from posegaussian.stages.pose.tracking import Followed, follow, others_in_space, swaps_told
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import to_set

NEAREST_SUBJECT = 0.5
"""Metres; the least depth assumed where no joint's depth is known."""


def run(inputs: Inputs, params: PoseParams) -> Iterator[Block]:
    """Yield pose/joints3d, then pose/joints2d and, while `pose_heatmaps` is on, pose/heatmaps view by view; where an
    estimator segments people pose/chosen and pose/alone, and where people are followed pose/others3d, too.

    Joints keep the joint set they came in, the 2D source's where there is one; heatmaps are COCO-17. Only source views'
    detections are read, of frames where the view is valid; every other view knows its camera only and gets
    reprojections. With one source view its detections pass through and joints3d is unknown, unless the capture gives 3D
    joints. A joint whose estimate stands has the estimator's own heatmap while `params.heatmaps` is model, every other
    one a Gaussian.
    """
    set_id = joint_set_of(inputs)
    followed = follow(inputs, params, set_id)
    frames = [_frame(inputs, params, followed, f, set_id) for f in range(len(inputs.partition))]
    joints3d, joints2d, depth, stands = (np.stack(part) for part in zip(*frames, strict=True))
    chosen = None
    if SEGMENTED in inputs.facts:
        by_joints = followed.chosen if ESTIMATED in inputs.facts else found_subject(inputs, joints2d, set_id)
        hidden = hidden_subject(inputs, by_joints, joints3d, set_id)
        alone = nobody_else(inputs, by_joints) & ~hidden.any(axis=1)
        chosen = np.where(hidden, HIDDEN, held_subject(inputs, by_joints, joints3d, alone))
        yield Block("pose/alone", alone.astype(np.uint8)[:, None])
    unknown = () if in_one_picture(inputs.facts) else unknown_note("pose/joints3d", joints3d)
    yield Block("pose/joints3d", joints3d.astype(np.float32), notes=(*_told(inputs, params, followed), *unknown))
    if TRACKED in inputs.facts:
        yield Block("pose/others3d", others_in_space(inputs, params, set_id, followed.joints).astype(np.float32))
    grid = grid_of(inputs.rig.size)
    # A frame in which nobody is says nothing of a camera; the note on joints3d counts it.
    somebody = (joints2d[..., 2] > 0).any(axis=(1, 2)) | in_one_picture(inputs.facts)
    for v in range(len(inputs.rig)):
        told = v in inputs.views.sources or not in_one_picture(inputs.facts)
        yield Block(
            "pose/joints2d",
            joints2d[:, v].astype(np.float32),
            v,
            notes=unknown_note("pose/joints2d", joints2d[somebody, v]) if told else (),
        )
        if chosen is not None:
            yield Block("pose/chosen", chosen[:, v].astype(np.int32), v, notes=hidden_told(chosen, v, inputs))
        if POSE_HEATMAPS not in inputs.facts:
            continue
        sigma = np.full(depth[:, v].shape, params.sigma)
        if params.sigma_unit == "m":
            sigma *= np.sqrt(inputs.rig.intrinsics[v, 0, 0] * inputs.rig.intrinsics[v, 1, 1]) / depth[:, v]
        coco = to_set(
            np.concatenate(
                [joints2d[:, v, :, :2], sigma[..., None], joints2d[:, v, :, 2:], stands[:, v, :, None]], axis=-1
            ),
            set_id,
            "coco17",
        )
        width, height = (int(n) for n in inputs.rig.size[v])
        maps = draw(coco[..., [0, 1, 3]], coco[..., 2], (width, height), grid)
        if uses_model_maps(params, inputs.facts) and v in inputs.views.sources:
            put_model_maps(inputs, maps, coco[..., 3] * (coco[..., 4] > 0), followed, v)
        yield Block("pose/heatmaps", maps, v)


def _told(inputs: Inputs, params: PoseParams, followed: Followed) -> tuple[str, ...]:
    """Who of several people is the subject, where it jumps, and where left and right were exchanged."""
    who = (subject_told(inputs, params),) if TRACKED in inputs.facts and inputs.partition.start == 0 else ()
    return (*(w for w in who if w), *jumps_told(followed.jumped, inputs), *swaps_told(followed, inputs))


def _frame(
    inputs: Inputs, params: PoseParams, followed: Followed, frame: int, set_id: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Joints of one frame of the partition.

    3D [J, 4], 2D in all views [V, J, 3], depth of each [V, J] in metres, and whether a view's own detection stands [V,
    J]. A 3D joint that the capture gives is believed after what the frame's views say and before what other frames do.
    """
    joints3d = followed.points[frame]
    if JOINTS3D in inputs.facts:
        given = to_set(_given(inputs, frame), inputs.source("joints3d").joint_set, set_id)
        own = (joints3d[:, 3:] > 0) & ~followed.bridged[frame][:, None]
        joints3d = np.where(own | (given[:, 3:] <= 0), joints3d, given)
    return joints3d, *_in_views(inputs.rig, joints3d, followed.joints[frame], params)


def _given(inputs: Inputs, frame: int) -> np.ndarray:
    """[J, 4] 3D joints as the capture gives them, scores cut to 0..1; what is not finite is unknown."""
    given = np.asarray(inputs.source("joints3d").read(int(inputs.source_frames[frame])), dtype=np.float64)
    known = np.isfinite(given).all(axis=-1) & (given[:, 3] > 0)
    return np.where(known[:, None], np.concatenate([given[:, :3], np.minimum(given[:, 3:], 1.0)], axis=-1), 0.0)


def _in_views(
    rig: Rig, joints3d: np.ndarray, detected: np.ndarray, params: PoseParams
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """2D joints [V, J, 3], the depth [V, J] at which they lie, and which of them are detections, from joints3d [J, 4]
    and detections [V, J, 3].

    A detection stands where it agrees with the 3D joint or where there is none; elsewhere the reprojection takes its
    place with the 3D joint's score. A joint without 3D lies at the mean depth of the known ones, and where none is
    known as deep as the point all cameras look at.
    """
    pixels, depth = (np.moveaxis(a, 0, 1) for a in project(rig, joints3d[:, :3]))
    known = (joints3d[:, 3] > 0) & (depth > NEAR)
    unit = unit_of(rig, np.arange(len(rig)), detected, params.min_score)
    off = np.linalg.norm(detected[..., :2] - pixels, axis=-1) / unit[:, None]
    agrees = (detected[..., 2] >= params.min_score) & (off < params.max_residual)
    stands = (detected[..., 2] > 0) & (agrees | ~known)
    filled = np.concatenate([pixels, np.broadcast_to(joints3d[:, 3:], (*depth.shape, 1))], axis=-1)
    joints2d = np.where(stands[..., None], detected, np.where(known[..., None], filled, 0.0))
    mean = np.where(known, depth, 0.0).sum(-1) / np.maximum(known.sum(-1), 1)
    looked_at = np.maximum(project(rig, focus(rig))[1], NEAREST_SUBJECT)
    assumed = np.where(known.any(-1), mean, looked_at)
    return joints2d, np.where(known, depth, assumed[:, None]), stands


def check(block: Block, params: PoseParams) -> list[str]:
    """Raise ValueError for values that are not finite or scores outside 0..1."""
    data = np.asarray(block.data)
    where = block.array if block.view is None else f"{block.array} of view {block.view}"
    bad = ~np.isfinite(data)
    if bad.any():
        raise ValueError(f"{where}: {int(bad.sum())} of {data.size} values are not finite, the first is {data[bad][0]}")
    if block.array == "pose/chosen":
        return []
    score = data if block.array == "pose/heatmaps" else data[..., -1]
    if data.size and (score.min() < 0 or score.max() > 1):
        raise ValueError(f"{where}: scores run from {score.min():g} to {score.max():g}, the bounds are 0 and 1")
    return []


def in_one_picture(facts: Facts) -> bool:
    """Whether joints can be known in the only source view's picture alone; the plan says so."""
    return SINGLE_SOURCE in facts and JOINTS3D not in facts


def unknown_note(array: str, joints: np.ndarray) -> tuple[str, ...]:
    """A sentence where most joints [..., (..., score)] are unknown."""
    unknown = float((joints[..., -1] == 0).mean()) if joints.size else 0.0
    return (
        (
            (
                f"{array}: {unknown:.0%} of the joints are unknown; do enough views see the person, and does"
                " pose.joints_frame fit the joints?"
            ),
        )
        if unknown > 0.5
        else ()
    )
