"""Exposure by `inspect` and by the survey of a run: one measure, of one camera and of two."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.dags.inspection.inspect import footage_of
from posegaussian.dags.planning.selection import Selection
from posegaussian.stages.imaging.color import gain_table
from posegaussian.stages.inspection.finding import FindingVerdict
from posegaussian.stages.inspection.light import of_light
from posegaussian.stages.simulator.subjects.capsule_person import render, ring
from posegaussian.stages.simulator.subjects.motion import pose
from posegaussian.storage.exporters.images_layout import write_capture
from tests.support.pipeline import Pipeline


def test_a_darker_camera_is_found_and_by_the_same_amount(tmp_path: Path) -> None:
    """One stop less light, before a survey and in it: a camera is off the middle by what it is off another one.
    Cameras 15 degrees apart share surface points."""
    size, bones = 224, pose("stand", 0.0)
    rig = ring(24, size, 0).subset([0, 1, 2])
    color = np.stack(
        [render(bones, k, w, (size, size), 2)[0] for k, w in zip(rig.intrinsics, rig.world_to_camera, strict=True)]
    )[None]
    cv2.LUT(color[0, 0], gain_table(np.full(3, 0.5)), dst=color[0, 0])
    write_capture(tmp_path / "capture", rig, color, frame_rate=30.0)
    p = Pipeline(tmp_path / "archive", tmp_path / "capture", ["effects.exposure_matching=auto"], held_out="[]")
    p.register()
    (one,) = (f for f in of_light(footage_of(p.context())[0]) if f.cameras == ("cam00",))
    assert one.verdict is FindingVerdict.DOUBTFUL
    assert one.value is not None
    assert 0.75 < one.value < 1.0
    assert "darker" in one.sentence
    p.run(selection=Selection(only=frozenset({"survey"})), expect_failure=True)
    decision = p.plan().context.effects["exposure_matching"].decision
    assert decision is not None
    # The error of one pair against that of a camera's offset, which the whole group has a part in.
    assert decision.measured == pytest.approx(one.value, abs=0.1)
    assert "cam00" in decision.reason
