"""A few frames of all source views, reduced and cut out as a run cuts them out."""

from __future__ import annotations

from collections.abc import Callable
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
from posegaussian.stages.contract.judged import GIVEN_MATTE, PERSON_MATTE
from posegaussian.stages.depth.facts import LEFT_RIGHT_CHECK
from posegaussian.stages.detection.reader import joint_reader
from posegaussian.stages.detection.run import run as detection_of
from posegaussian.stages.frames.facts import LIGHT_STEADYING
from posegaussian.stages.frames.run import run as frames_in
from posegaussian.stages.imaging.pixel_effects import CROP_SCALE, UNDISTORTION
from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.judge.sources import FromSources
from posegaussian.stages.pose.run import run as pose_of
from posegaussian.stages.silhouettes.presence import LOOKED_THROUGH, shows_somebody, with_somebody
from posegaussian.stages.survey.algorithms.joints import people

CUTTING = frozenset({MASKS, JOINTS2D, JOINTS3D, ESTIMATED, SEGMENTED, SEVERAL_FRAMES, SINGLE_SOURCE, LIGHT_STEADYING})
"""Facts by which the subject is found. Who is followed over time is none of them: of a few frames nobody can be, and
the subject is the person on whom most views agree."""
CAMERAS = frozenset({UNDISTORTION.name, CROP_SCALE.name})
"""Effects by which cameras are corrected, here however little is off."""
ASKED = 5
"""Frames in which an estimator is asked for somebody, as many as the survey has asked it of: it takes seconds each."""


def frames_of(inputs: Inputs, most: int, turns: np.ndarray | None = None) -> Frames:
    """`frames/color`, `frames/mask` and, of a person who is cut out, `pose/joints2d` and `pose/joints3d` of at most
    `most` worked frames, evenly spread, of those that most source views have a picture of and that show somebody, see
    `frames_with_somebody`; in pixels of the rig, padded to the largest.

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
    at = frames_with_somebody(inputs, most)
    scope = TaskScope(**{f.name: getattr(inputs, f.name) for f in fields(TaskScope)})
    return replace(
        scope, partition=range(len(at)), source_frames=numbers[at], time=np.zeros(len(at)), valid=valid[at], view=None
    )


def frames_with_somebody(inputs: Inputs, most: int) -> np.ndarray:
    """[n] indices of at most `most` worked frames, evenly spread, of those that most source views have a picture of.

    Where less than half of the views show somebody in one of these, by given masks or by joints, it is of those in
    which at least half as many do as in the best, of some that are looked through.
    """
    sources = list(inputs.views.sources)
    seen = inputs.footage("pictures")[1][:, sources].sum(axis=1)
    whole, seeing = np.flatnonzero(seen == seen.max()), _seeing(inputs)
    if seeing is not None:
        looked_through = ASKED if ESTIMATED in inputs.facts else LOOKED_THROUGH
        whole = with_somebody(whole, whole[spread(len(whole), most)], seeing, len(sources), looked_through)
    return whole[spread(len(whole), most)]


def _seeing(inputs: Inputs) -> Callable[[int], int] | None:
    """Tells how many source views show somebody in a worked frame, by its index; None where nothing tells."""
    numbers, valid = inputs.footage("pictures")
    if GIVEN_MATTE in inputs.facts:
        masks = inputs.source("masks")

        def shows(view: int, number: int) -> bool:
            return any(shows_somebody(mask) for mask in masks.read(view, [number]))
    elif {PERSON_MATTE, JOINTS2D} <= inputs.facts:
        joints = joint_reader(inputs)

        def shows(view: int, number: int) -> bool:
            return people(joints.read(view, number)) > 0
    else:
        return None
    return lambda i: sum(shows(v, int(numbers[i])) for v in inputs.views.sources if valid[i, v])


def spread(frames: int, most: int) -> np.ndarray:
    """At most so many of the indices of so many frames, ascending, each the middle of an equal part."""
    count = min(most, frames)
    return ((np.arange(count) + 0.5) * frames / max(count, 1)).astype(int)
