"""A view without a partner: the pair it makes with nobody, so that its depth has a disparity like all others.

A camera stands beside it that never filmed, `ANGLE` apart at the subject: what counts as a px of disparity is then the
same share of the distance for every camera, and follows from nothing that a single view does not know.
"""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.geometry.rectification import RectifiedPair, Window, rectify
from posegaussian.storage.model.cameras import Rig

ANGLE = 25.0
"""Degrees at the subject between the view and the camera that never filmed."""
APART = math.tan(math.radians(ANGLE))
"""Their baseline over the distance of the subject."""


def single_pair(rig: Rig, view: int, subject: np.ndarray, scale: float = 1.0) -> RectifiedPair:
    """The pair of a view (index 0) and the camera beside it; `subject` [3] world metres, `scale` as in `rectify`.

    Raises ValueError for a subject behind the camera.
    """
    distance = float(rig.rotations[view, 2] @ (subject - rig.centres[view]))
    poses = rig.world_to_camera[[view, view]].copy()
    poses[1, 0, 3] -= APART * distance  # beside it along its own rows
    two = Rig(
        (rig.names[view], "beside"),
        rig.intrinsics[[view, view]],
        rig.distortion[[view, view]],
        poses,
        rig.size[[view, view]],
    )
    return rectify(two, 0, 1, subject, scale)


def beside(pair: RectifiedPair, window: Window) -> Window:
    """The window of the camera that never filmed: where the subject has a disparity of 0 between both, to a px."""
    distance = abs(pair.baseline) / APART
    return window[0] - round(float(pair.disparity(np.array(distance)))), *window[1:]
