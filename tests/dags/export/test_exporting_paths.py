"""Pictures of camera paths as files: each path and each camera has its own, and a video keeps the sequence's time."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from posegaussian.dags.export.background import BLACK
from posegaussian.dags.export.page import page_head
from posegaussian.dags.export.pictures import export_video, own_names, pictures, play_times, ticks, write_exports
from posegaussian.dags.export.request import ExportOrder
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.video import VideoFile
from tests.support.pipeline import Pipeline, film

SIZE = 32


def path_file(file: Path, rig: Rig, cameras: dict[str, tuple[int, tuple[int, int], int | None]]) -> str:
    """Cameras by name: which of the rig's, width and height, and the frame that it serves."""
    entries = []
    for name, (view, size, frame) in cameras.items():
        pose = rig.world_to_camera[view]
        entry = {"name": name, "width": size[0], "height": size[1], "K": rig.intrinsics[view].tolist()}
        entry |= {"R": pose[:3, :3].tolist(), "t": pose[:3, 3].tolist()}
        entries.append(entry if frame is None else {**entry, "frame": frame})
    file.write_text(json.dumps({"pixel_center": "half", "cameras": entries}))
    return str(file)


def rendered(folder: Path, frames: int, cameras: dict[str, tuple[int, tuple[int, int], int | None]]) -> Pipeline:
    rig = film(folder / "capture", views=3, size=SIZE, frames=frames, held_out=1).rig
    own = path_file(folder / "own.json", rig, cameras)
    paths = f'rendering.paths=["still cam00", "still cam01", "held_out", "{own}"]'
    p = Pipeline(folder / "archive", folder / "capture", ["depth.method=truth", paths])
    p.register()
    p.run()
    return p


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """Four frames of four paths, one of them a file whose camera serves the second alone."""
    cameras = {"late": (0, (SIZE, SIZE), 1)}
    return rendered(tmp_path_factory.mktemp("several"), 4, cameras)


@pytest.fixture(scope="module")
def instant(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """A single frame, of a file with two sizes among others."""
    cameras = {"low": (0, (SIZE, SIZE - 8), None), "tall": (1, (SIZE - 8, SIZE), None)}
    return rendered(tmp_path_factory.mktemp("instant"), 1, cameras)


def test_each_of_several_paths_has_files_of_its_own(several: Pipeline, tmp_path: Path) -> None:
    plan = several.plan()
    first, second, *_ = plan.context.paths
    said = write_exports(plan, tmp_path / "out.mp4", tmp_path / "frames", tmp_path / "sheet.png")
    kinds = [first, second, "held_out", "file"]
    assert {f.name for f in tmp_path.glob("*.*")} == {
        *(f"out_{k}.mp4" for k in kinds),
        *(f"sheet_{k}.png" for k in kinds),
    }
    assert first.startswith("still-")
    for kind, camera in zip(kinds, ("cam00", "cam01", "mid00", "late"), strict=True):
        count = 1 if kind == "file" else 4
        assert len(list((tmp_path / "frames" / kind / camera).glob("*.png"))) == count
        assert (tmp_path / "frames" / kind / "frames.csv").read_text().count("\n") == count + 1
    assert f"video of still cam01: {tmp_path / f'out_{second}.mp4'}" in said
    assert f"frames of held_out: 4 pictures in {tmp_path / 'frames/held_out'}" in said
    write_exports(plan, None, tmp_path / "frames", None)  # its own pictures are no strangers


def test_a_single_path_keeps_the_names_it_was_given(several: Pipeline) -> None:
    assert list(own_names(several.context("held_out")).values()) == [""]


def test_pictures_of_something_else_in_the_folder_of_a_path_are_found_before_the_run(
    several: Pipeline, tmp_path: Path
) -> None:
    order = ExportOrder(frames=tmp_path / "frames")
    order.check(several.context())
    stranger = tmp_path / "frames/held_out/cam77/000000.png"
    stranger.parent.mkdir(parents=True)
    stranger.write_bytes(b"somebody's")
    with pytest.raises(UserError, match=r"holds 1 picture of something else"):
        order.check(several.context())


def test_the_video_of_a_camera_that_serves_some_frames_is_as_long_as_the_sequence(
    several: Pipeline, tmp_path: Path
) -> None:
    results = Results(several.context())
    path = next(p for p in results.context.paths.values() if p.kind == "file")
    (served,) = [picture for _, _, picture, _ in pictures(results, path, BLACK)]
    (file,) = export_video(results, path, tmp_path / "late.mp4")
    shown = list(VideoFile(file).read(range(4)))
    assert len(shown) == VideoFile(file).count == 4
    assert shown[0].max() <= 3, "black before the first picture"
    for picture in shown[1:]:
        assert np.abs(picture.astype(int) - served).mean() < 10, "the last picture stays"


def test_frames_that_all_cameras_lack_take_their_time_in_videos_and_pages(tmp_path: Path) -> None:
    """At 30 a second without the frames 3 and 4: frame 5 is shown at 5/30 s, as frames.csv says. Frames 5 and 6 differ
    by less than a video of 32 px errs."""
    film(tmp_path / "capture", views=3, size=4 * SIZE, frames=7)
    for picture in (tmp_path / "capture").glob("*/*/00000[34].*"):
        picture.unlink()
    p = Pipeline(tmp_path / "archive", tmp_path / "capture", ["depth.method=truth", "rendering.paths=[still cam00]"])
    p.register()
    p.run()
    results = Results(p.context())
    assert results.context.source_frames.tolist() == [0, 1, 2, 5, 6]
    (path,) = results.context.paths.values()
    rendered = [picture for *_, picture, _ in pictures(results, path, BLACK)]
    (file,) = export_video(results, path, tmp_path / "out.mp4")
    shown = list(VideoFile(file).read(range(7)))
    assert (VideoFile(file).count, VideoFile(file).rate) == (7, 30)
    for picture, frame in zip(shown, (0, 1, 2, 2, 2, 3, 4), strict=True):
        off = [np.abs(picture.astype(int) - one).mean() for one in rendered]
        assert int(np.argmin(off)) == frame
    head = page_head(results.context, results.context.views.sources, None, BLACK)
    assert head["times"] == pytest.approx(np.array([0, 1, 2, 5, 6]) / 30)
    assert [page_head(p.with_settings(f"frames.range={r}").context(), [0], None, BLACK)["times"] for r in RANGES] == [
        pytest.approx(np.array(times) / 30) for times in RANGES.values()
    ]


RANGES = {"1:6": [0, 1, 4], "0:7:2": [0, 2, 6], "0:1": [0]}
"""Some of those frames, and the 30ths of a second from the first on at which they are shown."""


def at(numbers: Sequence[int], rate: float = 30.0) -> Context:
    """What the play times read of a sequence."""
    capture = SimpleNamespace(frame_rate=rate)
    return cast(Context, SimpleNamespace(source_frames=np.array(numbers), capture=capture))


def test_a_gap_is_played_no_longer_than_ten_seconds() -> None:
    assert play_times(at([0, 1, 2, 100_002, 100_003])) == pytest.approx([0, 1 / 30, 2 / 30, 10 + 2 / 30, 10 + 3 / 30])
    assert play_times(at([0, 1, 2, 9], rate=0.01)).tolist() == [0, 100, 200, 300], "frames that are rarer keep theirs"


def test_every_frame_has_a_moment_of_its_own_in_a_video() -> None:
    """Whatever the numbers: in order, none left out, and none off by more than half a picture where they are even."""
    assert ticks(at([0, 1, 2, 3, 7, 8])) == [0, 1, 2, 3, 7, 8]
    assert ticks(at([10, 20, 30, 50])) == [0, 1, 2, 4]
    assert ticks(at([0, 1, 3, 4, 6])) == [0, 1, 2, 3, 4], "20 of 30 a second"
    crowded = ticks(at([0, 5, 10, 11, 12, 13, 18, 23, 28, 60]))
    assert crowded[-1] == 12
    assert min(np.diff(crowded)) == 1
    assert ticks(at([4])) == [0]


def test_of_a_single_frame_only_steps_of_a_move_are_one_video(instant: Pipeline, tmp_path: Path) -> None:
    context = instant.context()
    path = next(p for p in context.paths.values() if p.kind == "file")
    written = export_video(Results(context), path, tmp_path / "out.mp4")
    assert [f.name for f in written] == ["out_low.mp4", "out_tall.mp4"]
    assert [VideoFile(f).size for f in written] == [(SIZE, SIZE - 8), (SIZE - 8, SIZE)]
    instant.run("orbit")
    turning = instant.context("orbit")
    (file,) = export_video(Results(turning), *turning.paths.values(), tmp_path / "orbit.mp4")
    assert (VideoFile(file).count, VideoFile(file).rate) == (48, 24)
    head = page_head(turning, turning.views.sources, "orbit", BLACK)
    assert (head["steps"], head["rate"]) == (48, 24)
