"""Importing: what belongs to the sequence, and what another capture under a used name meets."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from dags.fingerprint import own_parts
from storage.crop import Crop
from storage.errors import ConfigError
from storage.spec import digest
from tests.pipeline import Pipeline, film

BARS = 6
"""Rows above and below."""


def letterboxed(folder: Path) -> None:
    """Bars above and below the pictures of cam01."""
    for file in (folder / "images" / "cam01").iterdir():
        cv2.imwrite(str(file), np.pad(np.maximum(cv2.imread(str(file)), 90), ((BARS, BARS), (0, 0), (0, 0))))


@pytest.fixture
def boxed(tmp_path: Path) -> Pipeline:
    film(tmp_path / "capture", views=3, frames=2, masks=False, depth=False)
    letterboxed(tmp_path / "capture")
    made = Pipeline(tmp_path / "archive", tmp_path / "capture")
    made.register()
    return made


def test_a_crop_that_was_found_is_the_sequence_s_own_and_enters_fingerprints_as_the_setting_does(boxed: Pipeline) -> None:
    context = boxed.context()
    assert context.capture.crops == {"cam01": Crop(scale=1, offset=(0, -BARS))}
    np.testing.assert_array_equal(context.captured_to_calibrated, [[1, 0, 0], [1, 0, -BARS], [1, 0, 0], [1, 0, 0]])
    assert context.effects["crop_scale"].state == "on"
    overruled = boxed.with_settings("frames.crop={cam01: {offset: [0, -5]}}")
    np.testing.assert_array_equal(overruled.context().captured_to_calibrated[1], [1, 0, -5])

    def fingerprints() -> dict[str, str]:
        plan = boxed.plan()
        return {t.label(context.views.names): digest(own_parts(plan.context, t)) for t in plan.verdicts if t.stage == "frames"}

    before = fingerprints()
    other = dataclasses.replace(context.capture, crops={"cam01": Crop(scale=1, offset=(0, -5))})
    boxed.session.archive.create_sequence(context.sequence.name, other, boxed.partition)
    after = fingerprints()
    assert len(before) == 4
    assert {label for label, f in after.items() if f != before[label]} == {label for label in before if "cam01" in label}


def test_sizes_that_nothing_explains_are_refused_before_work(boxed: Pipeline) -> None:
    """In an archive of an older version, whose settings held the crop."""
    sequence = boxed.context().sequence
    boxed.session.archive.create_sequence(sequence.name, dataclasses.replace(sequence.capture, crops={}), boxed.partition)
    with pytest.raises(ConfigError, match=r"camera cam01: pictures are 48x60 px, the calibration is for 48x48 px; import the capture again"):
        boxed.plan()
