"""A camera that is late by whole frames, brought into step by `frames.time_offset`,
gives what it gives when it is not late."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from posegaussian.dags.planning.selection import Selection
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.readers.sources import open_source
from tests.support.pipeline import Pipeline, content, film

LATE = "cam01"


@pytest.fixture(scope="module")
def in_step(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("in_step")
    film(folder / "capture", views=3, size=32, frames=4, held_out=0, depth=False)
    return prepared(folder)


@pytest.fixture(scope="module")
def late(in_step: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """The same capture, one camera's files numbered two higher."""
    folder = tmp_path_factory.mktemp("late")
    film(folder / "capture", views=3, size=32, frames=4, held_out=0, depth=False)
    for kind in ("images", "masks"):
        for file in sorted((folder / "capture" / kind / LATE).iterdir(), reverse=True):
            file.rename(file.with_name(f"{int(file.stem) + 2:06d}{file.suffix}"))
    joints = folder / "capture" / "joints" / f"{LATE}.json"
    joints.write_text(re.sub(r"(\d{6})\.png", lambda m: f"{int(m[1]) + 2:06d}.png", joints.read_text()))
    return prepared(folder)


def prepared(folder: Path) -> Pipeline:
    made = Pipeline(folder / "archive", folder / "capture", ["effects.temporal_smoothing=off"], held_out="[]")
    made.register()
    return made


def test_the_results_are_those_of_a_capture_in_step(in_step: Pipeline, late: Pipeline) -> None:
    corrected = late.with_settings(f"frames.time_offset={{{LATE}: 2.3}}")
    for pipeline in (in_step, corrected):
        pipeline.run(selection=Selection(only=frozenset({"frames", "pose"})))
    wanted, got = content(in_step, but=("source/",)), content(corrected, but=("source/",))
    assert {"frames/color", "frames/mask", "pose/joints3d"} <= wanted.keys()
    assert wanted == got


def test_the_setting_makes_what_it_touches_stale_and_nothing_else(late: Pipeline) -> None:
    corrected = late.with_settings(f"frames.time_offset={{{LATE}: 1}}")
    numbers = corrected.context().capture.pictures
    assert [s.numbers for s in numbers] == [(0, 1, 2, 3), (1, 2, 3, 4), (0, 1, 2, 3)]
    assert corrected.context().valid.tolist() == [[True, False, True], *[[True, True, True]] * 3, [False, True, False]]
    assert late.context().capture.pictures[1].numbers == (2, 3, 4, 5)
    assert late.context().capture.pictures[0].digest([0, 1]) == numbers[0].digest([0, 1])


def test_less_than_half_a_frame_changes_nothing(late: Pipeline) -> None:
    assert (
        late.with_settings(f"frames.time_offset={{{LATE}: 0.4}}").context().capture.to_json()
        == late.context().capture.to_json()
    )


def test_an_offset_that_leaves_a_camera_without_pictures_is_refused(late: Pipeline) -> None:
    with pytest.raises(ConfigError, match=r"frames\.time_offset: 40 frames move all pictures of camera cam01 .* out"):
        _ = late.with_settings(f"frames.time_offset={{{LATE}: 40}}").context().capture


def test_an_unknown_camera_is_refused(late: Pipeline) -> None:
    with pytest.raises(ConfigError, match=r"frames\.time_offset: sequence person has no camera 'cam9'"):
        late.with_settings("frames.time_offset={cam9: 1}").context()
    with pytest.raises(ConfigError, match=r"detection\.box: sequence person has no camera 'cam9'; it has "):
        late.with_settings("detection.box={cam9: [0, 0, 10, 10]}").context()


def test_a_file_that_holds_all_frames_is_read_further(tmp_path: Path) -> None:
    """A video's pictures are counted, not named: the reader looks so much further."""
    import numpy as np

    from posegaussian.storage.exporters.video import write_video
    from posegaussian.storage.model.capture import Capture, SourceFile, Stream
    from tests.support.known_geometry import ring

    pictures = [np.full((32, 32, 3), 40 * n, np.uint8) for n in range(6)]
    write_video(tmp_path / "a.mp4", pictures, 25.0)
    stream = Stream("video", (SourceFile.of(tmp_path / "a.mp4"),), tuple(range(6)), (32, 32))
    capture = Capture("images", ring(2, (32, 32)), 25.0, (stream, stream)).in_step((0, 2))
    reader = open_source(capture, "pictures")
    assert reader.numbers(1).tolist() == [0, 1, 2, 3]
    plain, shifted = (list(reader.read(v, n)) for v, n in ((0, [2, 3]), (1, [0, 1])))
    np.testing.assert_array_equal(plain, shifted)
