"""A camera whose pictures are upside down against its calibration is told by joints; nothing else is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.trust import Told
from posegaussian.stages.imaging.small_turns import SIDE
from posegaussian.stages.survey.standing.standing import standing_in, told
from posegaussian.stages.survey.standing.upside_down import upside_down
from posegaussian.storage.model.cameras import Rig
from tests.stages.survey.test_joint_standing import FRAMES, LEFT, RIGHT, SIZE, detected, written
from tests.support.walking_skeleton import SKELETON, Joints2D, moving, pixels, ring, roles


def overhead(joints: np.ndarray) -> np.ndarray:
    out = joints.copy()
    out[..., :2] = SIZE - joints[..., :2]
    return out


def seen(rig: Rig, *cameras: int, seed: int = 0) -> np.ndarray:
    joints = detected(rig, 2.0, seed)
    for v in cameras:
        joints[v] = overhead(joints[v])
    return joints


def inputs_of(rig: Rig, joints: np.ndarray) -> Any:
    return SimpleNamespace(
        facts=frozenset({"joints2d"}),
        views=roles(rig),
        rig=rig,
        source_rig=rig,
        captured_to_calibrated=np.tile([1.0, 0.0, 0.0], (len(rig), 1)),
        source=lambda kind: Joints2D.single(joints.swapaxes(0, 1)),
    )


@pytest.mark.parametrize("views", [4, 6, 9])
def test_a_camera_that_is_upside_down_is_told(views: int) -> None:
    rig = ring(views, SIZE)
    for v in range(0, views, 2):
        (camera, px) = upside_down(rig, seen(rig, v, seed=v)) or (None, 0.0)
        assert camera == v
        assert px > 0.05 * SIDE


@pytest.mark.parametrize("views", [4, 6, 9])
def test_nobody_is_told_so_who_stands_right_or_is_wrong_otherwise(views: int) -> None:
    rig = ring(views, SIZE)
    for seed in range(3):
        assert upside_down(rig, detected(rig, 3.0, seed)) is None
    joints = detected(rig)
    for by in (18.0, 60.0, 120.0):
        assert upside_down(written(rig, {2: (0.0, by, 0.0)})[0], joints) is None
    late, elsewhere, labels, exchanged = (joints.copy() for _ in range(4))
    late[2] = pixels(rig, moving(FRAMES + 12)[12:])[:, 2]
    elsewhere[2] = pixels(rig, SKELETON[None] * [1, 1, 0.7] + [[[0.5, 0.4, 0.0]]])[:, 2]
    labels[2, :, LEFT], labels[2, :, RIGHT] = joints[2, :, RIGHT], joints[2, :, LEFT]
    exchanged[[0, views // 2]] = joints[[views // 2, 0]]
    aside = seen(rig, 2)
    aside[2, ..., 0] += 0.03 * SIZE  # upside down, and wrong otherwise: turned, it is nearer and does not fit
    for wrong in (late, elsewhere, labels, exchanged, aside, seen(rig, 0, 1)):
        assert upside_down(rig, wrong) is None


def test_of_three_cameras_nobody_can_tell() -> None:
    rig = ring(3, SIZE)
    assert upside_down(rig, seen(rig, 1)) is None


def test_a_survey_notes_it_of_that_camera_alone() -> None:
    rig = ring(6, SIZE)
    inputs = inputs_of(rig, seen(rig, 4))
    rows = told(standing_in(inputs, np.arange(FRAMES)), inputs)
    assert rows[:, 4].tolist() == [0, 0, 0, 0, Told.UPSIDE_DOWN, 0]
    assert rows[4, 3] > 0.05
    assert not rows[:, :3].any()
