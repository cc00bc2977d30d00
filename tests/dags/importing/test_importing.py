"""Importing: what belongs to the sequence, and what another capture under a used name meets."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.fingerprint import own_parts
from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.variants import settled_variant
from posegaussian.stages.inspection.cameras import of_lens
from posegaussian.storage.archive import set_aside
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.model.errors import ArchiveError, ConfigError, LeaseHeld
from posegaussian.storage.model.spec import digest
from tests.support.pipeline import NAME, Pipeline, film

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


def test_a_crop_that_was_found_is_the_sequence_s_own_and_enters_fingerprints_as_the_setting_does(
    boxed: Pipeline,
) -> None:
    context = boxed.context()
    assert context.capture.crops == {"cam01": Crop(scale=1, offset=(0, -BARS))}
    np.testing.assert_array_equal(context.captured_to_calibrated, [[1, 0, 0], [1, 0, -BARS], [1, 0, 0], [1, 0, 0]])
    assert context.effects["crop_scale"].state == "on"
    overruled = boxed.with_settings("frames.crop={cam01: {offset: [0, -5]}}")
    np.testing.assert_array_equal(overruled.context().captured_to_calibrated[1], [1, 0, -5])

    def fingerprints() -> dict[str, str]:
        plan = boxed.plan()
        return {
            t.label(context.views.names): digest(own_parts(plan.context, t))
            for t in plan.verdicts
            if t.stage == "frames"
        }

    before = fingerprints()
    other = dataclasses.replace(context.capture, crops={"cam01": Crop(scale=1, offset=(0, -5))})
    boxed.session.archive.create_sequence(context.sequence.name, other, boxed.partition)
    after = fingerprints()
    assert len(before) == 4
    assert {label for label, f in after.items() if f != before[label]} == {
        label for label in before if "cam01" in label
    }


def test_sizes_that_nothing_explains_are_refused_before_work(boxed: Pipeline) -> None:
    """In an archive of an older version, whose settings held the crop."""
    sequence = boxed.context().sequence
    boxed.session.archive.create_sequence(
        sequence.name, dataclasses.replace(sequence.capture, crops={}), boxed.partition
    )
    with pytest.raises(
        ConfigError,
        match=r"camera cam01: pictures are 48x60 px, the calibration is for 48x48 px; import the capture again",
    ):
        boxed.plan()


@pytest.fixture
def two(tmp_path: Path) -> tuple[Pipeline, Pipeline]:
    """A sequence with results, and another capture that is to be imported under its name."""
    film(tmp_path / "walk", views=3, frames=2, masks=False, depth=False)
    film(tmp_path / "jump", views=2, frames=5, motion="wave", masks=False, depth=False)
    old = Pipeline(tmp_path / "archive", tmp_path / "walk", ["frames.range=0:1", "frames.matte=plate"])
    old.register()
    old.run(selection=Selection(only=frozenset({"survey", "frames"})))
    return old, Pipeline(old.root, tmp_path / "jump", partition=3)


def register_again(p: Pipeline, **more: bool) -> list[str]:
    settings = p.configuration.for_sequence(NAME)
    return register(p.session.archive, NAME, find_capture("images", p.folder, [], settings), settings, **more)[1]


def test_another_capture_under_a_used_name_is_refused_with_what_is_there_and_what_would_go(
    two: tuple[Pipeline, Pipeline],
) -> None:
    old, new = two
    with pytest.raises(ArchiveError) as refused:
        register_again(new)
    assert (
        str(refused.value)
        == "sequence person is there already: layout images, 4 cameras (cam00, cam01, cam02, mid00), 2 frames (0..1),"
        f" pictures in {old.folder}/images; this is another capture, with no picture in common: give it a name of"
        " its own with --sequence, or put it in the other's place with --replace, which deletes all that was"
        " computed from it (8 results)"
    )
    assert old.plan(selection=Selection(only=frozenset({"frames"}))).book.receipts
    assert old.context().capture.rig.names == ("cam00", "cam01", "cam02", "mid00")


def test_replacing_leaves_nothing_of_the_other_capture(two: tuple[Pipeline, Pipeline]) -> None:
    """The survey is kept when a capture grows: a background plate of another room must not be."""
    _, new = two
    (said,) = register_again(new, replace=True)
    assert said.startswith(
        "replaced: layout images, 4 cameras (cam00, cam01, cam02, mid00), 2 frames (0..1), pictures in "
    )
    assert said.endswith("; deleted: all that was computed from it (8 results)")
    assert new.context().sequence.partition_frames == 3
    assert new.context().capture.rig.names == ("cam00", "cam01", "mid00")
    assert {r for v in new.plan().verdicts.values() for r in v.reasons if v.state is State.STALE} == {"never made"}
    assert not (new.root / NAME / "frames").exists()


def test_replacing_takes_variants_and_what_lies_aside_along(two: tuple[Pipeline, Pipeline]) -> None:
    old, new = two
    context = old.context()
    beside = settled_variant(context.sequence, context.settings, {"of": "a test"}, ()).sequence
    for sequence in (context.sequence, beside):
        assert set_aside.put(sequence, scan_receipts(sequence))
    places = [a.place(f"{set_aside.FOLDER}/{NAME}") for a in (old.session.archive, Archive(beside.root.parent))]
    assert all(p.is_dir() for p in (beside.root, *places))
    register_again(new, replace=True)
    assert not any(p.exists() for p in (beside.root, *places))
    assert beside.root.parent.is_dir(), "other sequences may have variants there"


def test_replacing_waits_for_no_run_and_takes_nothing_from_it(two: tuple[Pipeline, Pipeline]) -> None:
    old, new = two
    lease = Lease.take(old.context().sequence.receipts / "_runs" / "another.lease", "another", "driver", 60.0)
    try:
        with pytest.raises(LeaseHeld, match="import --replace: sequence person is worked on by"):
            register_again(new, replace=True)
        assert (old.root / NAME / "frames").exists()
    finally:
        lease.drop()


def test_the_same_capture_is_updated_without_a_question(two: tuple[Pipeline, Pipeline], tmp_path: Path) -> None:
    """Grown, filmed again in place, moved to another folder, with fewer cameras or another calibration."""
    old, _ = two
    assert register_again(old) == ["sequence person is unchanged"]
    film(old.folder, views=3, frames=4, masks=False, depth=False)
    assert register_again(old) == ["sequence person was registered before; its results are kept where they still hold"]
    assert len(old.context().capture.numbers) == 4
    old.folder.rename(tmp_path / "elsewhere")
    moved = Pipeline(old.root, tmp_path / "elsewhere")
    cameras = moved.folder / "cameras.json"
    cameras.write_text(cameras.read_text().replace('"pixel_center": "half"', '"pixel_center": "integer"'))
    assert "registered before" in register_again(moved)[0]
    film(moved.folder, views=3, frames=4, motion="wave", masks=False, depth=False)
    assert "registered before" in register_again(moved)[0]
    assert any(v.state is State.FRESH for v in old.plan().verdicts.values())


def test_a_lens_that_folds_back_within_the_picture_is_said(tmp_path: Path) -> None:
    """As `inspect` finds it later: k1 = -1 shows nothing beyond 2 / (3 sqrt(3)) of the focal length."""
    film(tmp_path / "capture", views=3, frames=2, masks=False, depth=False)
    made = Pipeline(tmp_path / "archive", tmp_path / "capture")
    settings = made.configuration.for_sequence(NAME)
    capture = find_capture("images", tmp_path / "capture", [], settings)
    archive = Archive.open(made.session.archive_url, create=True)
    assert not any("lens" in n for n in register(archive, NAME, capture, settings)[1])
    bent = capture.rig.distortion.copy()
    bent[1, 0] = -1.0
    folding = dataclasses.replace(capture, rig=dataclasses.replace(capture.rig, distortion=bent))
    (told,) = (n for n in register(archive, NAME, folding, settings)[1] if "lens" in n)
    (found,) = (f for f in of_lens(folding.rig, 1) if f.measure == "lens model")
    assert found.value is not None
    assert found.value < 1
    assert told.startswith(f"camera cam01: the lens model folds back at {found.value:.0%} of the way to the corner")
