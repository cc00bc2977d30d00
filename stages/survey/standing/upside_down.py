"""A camera whose pictures are upside down against its calibration, by where they show a person's joints.

A phone or an action camera that hangs upside down says so in its file, and one program heeds it and another does not.
Such a camera contradicts all others, and no small turn of it mends that.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.geometry.triangulation import Tracks
from posegaussian.stages.imaging.small_turns import SIDE
from posegaussian.stages.survey.algorithms.joints import SCORE
from posegaussian.stages.survey.standing.by_joints import (
    APART,
    CURED,
    EXACT,
    FEWEST_JOINTS,
    beside,
    meeting_points,
    scatter,
)
from posegaussian.storage.model.cameras import Rig

FAR = 0.05
"""Share of the longer side by which joints must lie beside those of the others: 0.33 of a filmed man."""
NEARER = 4.0
"""Times nearer they must lie once the pictures are turned by 180 degrees."""


def upside_down(rig: Rig, joints: np.ndarray) -> tuple[int, float] | None:
    """(camera, px of a picture of `SIDE` px by which its joints lie beside those of the others) of S cameras' joints
    [S, F, 17, 3] of one person, px of the rig: of the only one without which all others agree, and with which they do,
    too, once its pictures are turned by 180 degrees; None where there is none, or more than one."""
    views, frames = range(len(rig)), joints.shape[1:3]
    tracks = Tracks.of(rig, np.arange(len(rig)), joints.reshape(len(rig), -1, 3), SCORE)
    found = []
    for v in views:
        right = [w for w in views if w != v]
        among, known = scatter(rig, tracks, right), (tracks.weights[right] > 0).sum(axis=0) >= 2
        if not among <= APART or (known & (tracks.weights[v] > 0)).sum() < FEWEST_JOINTS:
            continue
        points, told = meeting_points(tracks, right).reshape(*frames, 3), known.reshape(frames)
        turned = joints[v].copy()
        turned[..., :2] = rig.size[v] - turned[..., :2]
        apart, after = (beside(rig.subset([v]), seen, points, told) for seen in (joints[v], turned))
        if apart >= max(FAR * SIDE, NEARER * after) and after <= CURED * max(EXACT, among):
            found.append((v, apart))
    return found[0] if len(found) == 1 else None
