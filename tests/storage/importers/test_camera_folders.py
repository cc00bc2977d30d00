"""Videos in a folder a camera: the one video is the camera's, chapters are joined as the sentence says."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.importers.recognise import recognised
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.images import write_png
from tests.storage.importers import test_easymocap, test_pose2sim, test_videos
from tests.support import colmap_files, import_capture, ring
from tests.support.video_clips import counting_clip

Layout = tuple[tuple[str, ...], tuple[int, int], Callable[[Path], object]]


def colmap(base: Path) -> None:
    """A model of one image a camera, which videos go before."""
    colmap_files.write_binary(base / "sparse" / "0", colmap_files.rig([f"{n}.png" for n in import_capture.NAMES]))
    (base / "images").mkdir()
    for name in import_capture.NAMES:
        write_png(base / "images" / f"{name}.png", np.zeros((48, 64, 3), np.uint8))


LAYOUTS: dict[str, Layout] = {
    "pose2sim": (import_capture.NAMES, import_capture.SIZE, test_pose2sim.write_calibration),
    "videos": (test_videos.NAMES, ring.SIZE, test_videos.kalibr),
    "easymocap": (test_easymocap.NAMES, import_capture.SIZE, test_easymocap.write_calibration),
    "colmap": (import_capture.NAMES, import_capture.SIZE, colmap),
}


@dataclass(frozen=True)
class Cards:
    """A capture with `videos/NAME/GX010042.MP4` of every camera, and its calibration."""

    layout: str
    names: tuple[str, ...]
    base: Path
    size: tuple[int, int]

    def film(self, place: str, count: int = 6) -> Path:
        path = self.base / "videos" / place
        path.parent.mkdir(parents=True, exist_ok=True)
        return counting_clip(path.with_suffix(".mp4"), count, self.size).rename(path)

    def pictures(self) -> dict[str, Path]:
        """{camera: the file its pictures come from}."""
        capture = find_capture(self.layout, self.base, {})
        return {n: Path(s.files[0].path) for n, s in zip(capture.rig.names, capture.pictures, strict=True)}


@pytest.fixture(params=LAYOUTS)
def cards(request: pytest.FixtureRequest, tmp_path: Path) -> Cards:
    names, size, calibrate = LAYOUTS[request.param]
    capture = Cards(request.param, names, tmp_path, size)
    calibrate(tmp_path)
    for name in names:
        capture.film(f"{name}/GX010042.MP4")
    return capture


def test_the_one_video_in_a_cameras_folder_is_the_cameras(cards: Cards) -> None:
    assert cards.pictures() == {n: cards.base / "videos" / n / "GX010042.MP4" for n in cards.names}
    assert recognised(cards.base) == cards.layout


def test_folders_that_no_camera_is_named_after_are_not_looked_into(cards: Cards) -> None:
    cards.film("rehearsal/GX010041.MP4")
    cards.film("rehearsal/GX020041.MP4")
    assert cards.pictures() == {n: cards.base / "videos" / n / "GX010042.MP4" for n in cards.names}


def test_chapters_are_told_with_how_they_are_joined_and_the_joined_file_is_taken(cards: Cards) -> None:
    cards.film(f"{cards.names[1]}/GX020042.MP4")
    folder = cards.base / "videos" / cards.names[1]
    with pytest.raises(SourceError) as told:
        cards.pictures()
    start, _, command = str(told.value).partition(" without encoding again: ")
    assert start.startswith(f"camera {cards.names[1]} has 2 videos in {folder}: GX010042.MP4, GX020042.MP4; take out")
    assert command == (
        f"cd {folder} && printf \"file '%s'\\n\" GX010042.MP4 GX020042.MP4 > chapters.txt && ffmpeg -f concat -safe 0"
        f" -i chapters.txt -c copy ../{cards.names[1]}.mp4"
    )
    listing = command[: command.index(" && ffmpeg")]
    subprocess.run(["bash", "-c", listing], check=True)
    assert (folder / "chapters.txt").read_text() == "file 'GX010042.MP4'\nfile 'GX020042.MP4'\n"
    joined = cards.film(f"{cards.names[1]}.mp4")
    assert cards.pictures() == {
        n: joined if n == cards.names[1] else cards.base / "videos" / n / "GX010042.MP4" for n in cards.names
    }


def test_chapters_beside_videos_that_were_joined_elsewhere_are_left_alone(tmp_path: Path) -> None:
    names, size, calibrate = LAYOUTS["pose2sim"]
    cards = Cards("pose2sim", names, tmp_path, size)
    calibrate(tmp_path)
    joined = {n: cards.film(f"{n}.mp4") for n in names}
    for n in names:
        cards.film(f"../cards/{n}/GX010042.MP4")
        cards.film(f"../cards/{n}/GX020042.MP4")
    assert cards.pictures() == joined
