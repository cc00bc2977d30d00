"""A camera whose recording stood still, by its files, before the masks that contradict it."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from posegaussian.dags.inspection.inspect import footage_of
from posegaussian.dags.planning.context import Context
from posegaussian.stages.inspection.cameras import of_repeats
from posegaussian.stages.inspection.finding import FindingVerdict, measured, worst_first
from tests.support.pipeline import Pipeline, film


def context_of(capture: Path, archive: Path) -> Context:
    pipeline = Pipeline(archive, capture, held_out="[]")
    pipeline.register()
    return pipeline.context()


def still(folder: Path, frames: range) -> None:
    """Pictures and masks of a camera in some frames are those of the first of them."""
    for kind in ("images", "masks"):
        files = sorted((folder / kind / "cam01").iterdir())
        for n in frames[1:]:
            shutil.copy(files[frames[0]], files[n])


def test_a_camera_that_stands_still_is_named_before_what_follows_from_it(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=4, frames=6, held_out=0, joints=False, depth=False)
    footage = footage_of(context_of(tmp_path / "capture", tmp_path / "archive"))[0]
    assert {f.verdict for f in of_repeats(footage)} == {FindingVerdict.GOOD}
    still(tmp_path / "capture", range(2, 6))
    stood = footage_of(context_of(tmp_path / "capture", tmp_path / "other"))[0]
    found = of_repeats(stood)
    (told,) = (f for f in found if f.verdict is not FindingVerdict.GOOD)
    assert (told.cameras, told.value, told.verdict) == (("cam01",), 0.5, FindingVerdict.BAD)
    assert "frames 2 to 5 show the same" in told.sentence
    contradicted = measured("mask agreement", ["cam02"], 0.1, "of the rim", 0.98, 0.9, "", "")
    assert worst_first([contradicted, told])[0] is told


def test_a_camera_that_nobody_is_seen_by_may_show_the_same_for_long(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=4, frames=6, held_out=0, joints=False, depth=False)
    still(tmp_path / "capture", range(6))
    footage = footage_of(context_of(tmp_path / "capture", tmp_path / "archive"))[0]

    class Empty:
        def read(self, view: int, numbers: list[int]) -> list[np.ndarray]:
            return [np.zeros((8, 8), np.uint8) for _ in numbers]

    nobody = replace(footage, readers={**footage.readers, "masks": Empty()}, told={})
    assert {f.verdict for f in of_repeats(nobody)} == {FindingVerdict.GOOD}
    assert {f.verdict for f in of_repeats(footage)} == {FindingVerdict.GOOD, FindingVerdict.BAD}
