"""A few frames of all source views, reduced and cut out as a run cuts them out."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from posegaussian.stages.contract.facts import (
    ESTIMATED,
    JOINTS2D,
    JOINTS3D,
    MASKS,
    SEGMENTED,
    SEVERAL_FRAMES,
    SINGLE_SOURCE,
    Facts,
)
from posegaussian.stages.contract.io import Inputs, TaskScope
from posegaussian.stages.contract.judged import PERSON_MATTE
from posegaussian.stages.depth.facts import LEFT_RIGHT_CHECK
from posegaussian.stages.detection.run import run as detection_of
from posegaussian.stages.frames.facts import LIGHT_STEADYING
from posegaussian.stages.frames.run import run as frames_in
from posegaussian.stages.imaging.pixel_effects import CROP_SCALE, UNDISTORTION
from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.judge.sources import FromSources
from posegaussian.stages.pose.run import run as pose_of

CUTTING = frozenset({MASKS, JOINTS2D, JOINTS3D, ESTIMATED, SEGMENTED, SEVERAL_FRAMES, SINGLE_SOURCE, LIGHT_STEADYING})
"""Facts by which the subject is found. Who is followed over time is none of them: of a few frames nobody can be, and
the subject is the person on whom most views agree."""
CAMERAS = frozenset({UNDISTORTION.name, CROP_SCALE.name})
"""Effects by which cameras are corrected, here however little is off."""


def frames_of(inputs: Inputs, most: int, turns: np.ndarray | None = None) -> Frames:
    """`frames/color`, `frames/mask` and, of a person who is cut out, `pose/joints2d` and `pose/joints3d` of at most
    `most` worked frames, evenly spread, of those that most source views have a picture of; in pixels of the rig, padded
    to the largest.

    Masks are those that the frames stage makes of the same frames, after detection and pose where a person is cut out;
    a mask is empty where nobody was found. turns: [V, 3] rad by which cameras stand turned against what is written
    down, or None.
    """
    scope = _scope(inputs, most)
    if turns is not None:
        scope = replace(scope, rig=turned(scope.rig, turns))
    facts = (inputs.facts & CUTTING) | CAMERAS
    few, settings = FromSources(replace(scope, facts=facts), inputs), inputs.settings
    if PERSON_MATTE in inputs.facts:
        if inputs.facts & {ESTIMATED, SEGMENTED}:
            few.put(detection_of(few, settings["detection"]))
        # A few frames far apart: nothing bridges them.
        few.put(pose_of(few, settings["pose"].model_copy(update={"bridge": 0})))
    for v in inputs.views.sources:
        few.put(frames_in(few.of_view(v), settings["frames"]))
    names = [
        "frames/color",
        "frames/mask",
        *(["pose/joints2d", "pose/joints3d"] if PERSON_MATTE in inputs.facts else []),
    ]
    return Frames(replace(scope, facts=Facts(CAMERAS | {LEFT_RIGHT_CHECK})), {name: few.read(name) for name in names})


def _scope(inputs: Inputs, most: int) -> TaskScope:
    """That of the chosen frames."""
    numbers, valid = inputs.footage("pictures")
    seen = valid[:, list(inputs.views.sources)].sum(axis=1)
    whole = np.flatnonzero(seen == seen.max())
    at = whole[spread(len(whole), most)]
    scope = TaskScope(**{f.name: getattr(inputs, f.name) for f in fields(TaskScope)})
    return replace(
        scope, partition=range(len(at)), source_frames=numbers[at], time=np.zeros(len(at)), valid=valid[at], view=None
    )


def spread(frames: int, most: int) -> np.ndarray:
    """At most so many of the indices of so many frames, ascending, each the middle of an equal part."""
    count = min(most, frames)
    return ((np.arange(count) + 0.5) * frames / max(count, 1)).astype(int)
