"""Where the rig says somebody is, in views whose estimator did not find that person there.

Alone, an estimator takes an onlooker for the subject, or puts joints beside the body with a high score. What several
views agree on in space tells where to look again.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.estimators.interface import Found
from posegaussian.stages.following.association import associate
from posegaussian.stages.geometry.points import NEAR, project, to_frames
from posegaussian.stages.geometry.triangulation import triangulate, unit_of
from posegaussian.stages.imaging.camera_mapping import captured_positions, switched
from posegaussian.stages.imaging.regions import MARGIN
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set, to_set

SCORE = 0.3
"""Least score of a joint that is triangulated."""
RESIDUAL = 0.02
"""Reprojection error above which a view's joint does not agree, a share as `unit_of` has it."""
FEWEST = 6
"""Joints in space below which there is nobody to look for."""
AGREEING = 0.5
"""Share of the joints in space that a view's person must agree with; else the view is looked at again."""
RIM = 1.15
"""Radius of a body's circle over the distance of its farthest joint: hands, feet and skull reach beyond."""


@dataclass(frozen=True, eq=False)
class Space:
    """The cameras of one task, and the joints' names."""

    inputs: Inputs
    joint_set: str

    def to_frames(self, found: Found, view: int) -> np.ndarray:
        """[P, J, 3] joints in pixels of frames/*; score 0 where the lens maps a joint nowhere."""
        source_rig, crops = switched(self.inputs.source_rig, self.inputs.captured_to_calibrated, self.inputs.facts)
        joints = np.asarray(found.joints, dtype=np.float64)
        pixels, mapped = to_frames(joints[..., :2], crops[view], source_rig, self.inputs.rig, view)
        return np.concatenate([pixels, np.where(mapped, joints[..., 2], 0.0)[..., None]], axis=-1)

    def to_captured(self, pixels: np.ndarray, view: int) -> np.ndarray:
        """[..., 2] captured px of pixels of frames/*; NaN where the lens has no picture of them."""
        source_rig, crops = switched(self.inputs.source_rig, self.inputs.captured_to_calibrated, self.inputs.facts)
        return captured_positions(
            pixels,
            self.inputs.rig.intrinsics[view],
            source_rig.intrinsics[view],
            source_rig.distortion[view],
            crops[view],
        )


def astray(
    space: Space, found: dict[int, list[Found]], most: int, settled: Collection[int] = ()
) -> dict[int, dict[int, np.ndarray]]:
    """{view: {frame: regions [N, 4]}} captured px: where to look again, for up to `most` people, the best seen first.

    found: {source view: what was found in each frame of the partition}; settled: views that are not asked again.
    """
    again: dict[int, dict[int, list[np.ndarray]]] = {v: defaultdict(list) for v in found}
    sources, nobody = sorted(found), np.zeros((len(joint_set(space.joint_set)), 3))
    rig = space.inputs.rig.subset(sources)
    for frame in range(len(space.inputs.partition)):
        people = [space.to_frames(found[v][frame], v) for v in sources]
        for person in associate(rig, [to_set(p, space.joint_set, "coco17") for p in people])[:most]:
            seen = np.stack([p[i] if i >= 0 else nobody for p, i in zip(people, person.members, strict=True)])
            joints3d = triangulate(rig, seen, SCORE, RESIDUAL)
            if (joints3d[:, 3] > 0).sum() < FEWEST:
                continue
            for s, v in enumerate(sources):
                if v in settled or not space.inputs.valid[frame, v] or _agrees(rig, s, seen[s], joints3d):
                    continue
                region = _region(space, v, joints3d)
                if region is not None:
                    again[v][frame].append(region)
    return {v: {f: np.stack(r) for f, r in regions.items()} for v, regions in again.items() if regions}


def _agrees(rig: Rig, view: int, seen: np.ndarray, joints3d: np.ndarray) -> bool:
    """Whether enough of a view's joints [J, 3] lie where the joints in space [J, 4] are seen."""
    known = joints3d[:, 3] > 0
    pixels, _ = project(rig, joints3d[:, :3])
    unit = unit_of(rig, np.array([view]), seen[None], SCORE)[0]
    off = np.linalg.norm(pixels[:, view] - seen[:, :2], axis=-1) / unit
    return bool(((seen[:, 2] >= SCORE) & (off < RESIDUAL))[known].mean() >= AGREEING)


def _region(space: Space, view: int, joints3d: np.ndarray) -> np.ndarray | None:
    """[4] region around the joints in space as the view captures them;
    None where fewer than FEWEST of them lie in its picture."""
    pixels, depth = project(space.inputs.rig.subset([view]), joints3d[:, :3])
    captured = space.to_captured(pixels[:, 0], view)
    seen = (joints3d[:, 3] > 0) & (depth[:, 0] > NEAR) & np.isfinite(captured).all(axis=-1)
    if seen.sum() < FEWEST:
        return None
    region = body_region(captured, seen, space.joint_set)
    width, height = space.inputs.source("pictures").size(view)
    inside = (captured[seen] >= 0).all(axis=-1) & (captured[seen] <= (width, height)).all(axis=-1)
    return region if inside.sum() >= FEWEST else None


def body_region(joints: np.ndarray, known: np.ndarray, set_id: str) -> np.ndarray:
    """[4] (centre u, centre v, side, angle): a square around a body with margin, its upright from hips to shoulders.

    joints [J, 2] px, known [J]; without both hips the middle of the known joints is the centre, without shoulders the
    square stands upright.
    """
    names = joint_set(set_id).names
    hips, shoulders = (
        [names.index(n) for n in pair if n in names] for pair in (("LHip", "RHip"), ("LShoulder", "RShoulder"))
    )
    has = [len(pair) == 2 and bool(known[pair].all()) for pair in (hips, shoulders)]
    centre = joints[hips].mean(axis=0) if has[0] else joints[known].mean(axis=0)
    up = joints[shoulders].mean(axis=0) - centre if all(has) else np.array([0.0, -1.0])
    radius = RIM * np.linalg.norm(joints[known] - centre, axis=-1).max()
    return np.array([*centre, 2 * MARGIN * radius, np.arctan2(up[0], -up[1])])
