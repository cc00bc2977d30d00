"""What an estimator would find of the person of formulas: joints, and a segmentation as coarse as one likes."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from posegaussian.stages.frames.params import FramesParams
from posegaussian.stages.frames.segmentation_prior import Hints
from posegaussian.stages.frames.stage import STAGE
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture
from posegaussian.storage.model.cameras import Rig
from tests.support.memory_inputs import MemoryInputs

FACTS = frozenset({"several_frames", "joints2d", "detected", "segmented"})


def segmented(person: PersonCapture, cells: int = 256) -> dict[str, np.ndarray]:
    """detection/* and pose/* of one person a view, looked at in the whole picture;
    the segmentation is no finer than `cells`."""
    frames, views, size = person.mask.shape[:3]
    hint = np.zeros((frames, views, 1, 256, 256), np.uint8)
    for f in range(frames):
        for v in range(views):
            hint[f, v, 0] = cv2.resize(
                cv2.resize(person.mask[f, v], (cells, cells), interpolation=cv2.INTER_AREA),
                (256, 256),
                interpolation=cv2.INTER_LINEAR,
            )
    joints3d = np.ones((frames, 17, 4), np.float32)
    joints3d[..., :3] = person.joints3d[..., :3]
    return {
        "detection/person": hint,
        "detection/region": np.tile(np.array([size / 2, size / 2, size, 0.0], np.float32), (frames, views, 1, 1)),
        "pose/chosen": np.zeros((frames, views), np.int32),
        "pose/alone": np.ones((frames, 1), np.uint8),
        "pose/joints2d": person.joints2d.astype(np.float32),
        "pose/joints3d": joints3d,
    }


def hints_of(
    person: PersonCapture,
    arrays: dict[str, np.ndarray],
    view: int,
    facts: frozenset[str] = FACTS,
    source_rig: Rig | None = None,
) -> Hints:
    """The hints of one view's task over all frames; `source_rig`: the cameras with their lenses, None: without any."""
    frames, params, span = len(person.mask), FramesParams(), range(len(person.mask))
    inputs: Any = MemoryInputs(
        STAGE, params, arrays, person.rig, person.views, span, frames, view, facts=facts, source_rig=source_rig
    )
    return Hints(inputs, params.hint_margin)
