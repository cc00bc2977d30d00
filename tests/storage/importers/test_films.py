"""Videos of one rig: rates that part, frames that a camera dropped, and what goes with them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.films import with_dropped
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.sources import open_source
from posegaussian.storage.readers.video import VideoFile
from tests.storage.importers.test_videos import NAMES, find, kalibr
from tests.support import known_geometry, ring
from tests.support.video_clips import counted, counting_clip, planes, write_clip

WHOLE = tuple(range(12))
DROPPED = (0, 1, 2, 4, 5, 8, 9, 10, 11)
"""Instants that a camera kept; 3, 6 and 7 are lacking."""
MS = Fraction(1, 1000)


def film(path: Path, instants: Sequence[int], times: Sequence[int] | None = None, **more: object) -> Path:
    """A video whose frame at instant i is the grey i, shown at 1/30 i s or at the given times in ms."""
    greys = [planes(np.full(ring.SIZE[::-1], 16 + 3 * i, np.uint8)) for i in instants]
    if path.suffix == ".avi":
        return write_clip(path, greys, "mpeg4", times=list(instants), g=5, qmin=1, qmax=2, **more)
    shown = times or [round(1000 * i / 30) for i in instants]
    return write_clip(path, greys, times=shown, unit=MS, crf=1, **more)


def films(base: Path, suffix: str, lacking: Sequence[int] = DROPPED, **more: object) -> Path:
    base.mkdir(parents=True, exist_ok=True)
    for name in NAMES:
        film(base / f"{name}{suffix}", lacking if name == "cam1" else WHOLE, **more)
    kalibr(base)
    return base


def said(capture: Capture, about: str) -> list[str]:
    return [n for n in capture.notes if about in n]


def test_a_camera_whose_file_lasts_longer_than_it_holds_is_told(tmp_path: Path) -> None:
    base = films(tmp_path / "capture", ".mkv", WHOLE)
    path = base / "cam1.mkv"
    greys = [planes(np.full(ring.SIZE[::-1], 16 + 3 * i, np.uint8)) for i in range(60)]
    write_clip(path, greys, "ffv1", rate=30, g=1)
    untagged = path.read_bytes().replace(b"DURATION", b"XURATION")
    path.write_bytes(untagged[: len(untagged) // 2])
    (note,) = said(find(base), "cut off")
    assert re.fullmatch(
        r"camera cam1: the file says that it lasts 2\.0 s and ends after [01]\.\d s; it may be cut off: copy it again,"
        " unless it ends where the others do",
        note,
    )


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_frames_after_a_dropped_one_stay_in_step(tmp_path: Path, suffix: str) -> None:
    """Whatever the container: every frame keeps the number of its instant, and those that were dropped are lacking."""
    capture = find(films(tmp_path, suffix))
    assert [s.numbers for s in capture.pictures] == [WHOLE, DROPPED, WHOLE]
    source = open_source(capture, "pictures")
    assert [counted(p) for p in source.read(1, DROPPED)] == list(DROPPED)
    assert [counted(p) for p in source.read(1, [8, 11])] == [8, 11]
    assert said(
        capture, "camera cam1 dropped 3 frames while it filmed (3, 6-7); its later frames are numbered by their"
    )
    assert said(capture, "camera cam1 lacks pictures of 3 frames (3, 6-7)")
    assert capture.frame_rate == pytest.approx(30, rel=2e-3)
    assert not said(capture, "rates differ")
    with pytest.raises(SourceError, match="camera cam1 has no picture of frame 6"):
        next(source.read(1, [6]))


def test_masks_go_with_the_frames_of_the_file(tmp_path: Path) -> None:
    films(tmp_path, ".mp4")
    for v, name in enumerate(NAMES):
        for at in range(len(DROPPED) if v == 1 else len(WHOLE)):
            ring.write_mask(tmp_path / "masks" / name / f"{at:06d}.png", v, at)
    assert [s.numbers for s in find(tmp_path).masks if s] == [WHOLE, DROPPED, WHOLE]


def test_timecodes_bring_videos_with_dropped_frames_into_step(tmp_path: Path) -> None:
    films(tmp_path, ".mkv", timecode="01:00:00:00")
    film(tmp_path / "cam2.mkv", WHOLE, timecode="01:00:00:05")
    capture = find(tmp_path)
    assert [s.numbers for s in capture.pictures] == [WHOLE, DROPPED, tuple(n + 5 for n in WHOLE)]


def test_joints_in_space_keep_the_numbers_of_the_files(tmp_path: Path) -> None:
    videos = [SourceFile.of(p) for p in (film(tmp_path / "a.mp4", WHOLE), film(tmp_path / "b.mp4", DROPPED))]
    streams = tuple(Stream("video", (f,), tuple(range(VideoFile(f.path).count)), ring.SIZE) for f in videos)
    joints = Stream("trc", (videos[0],), WHOLE, options={"joint_set": "body_25"})
    given = Capture("pose2sim", known_geometry.ring(2, ring.SIZE), 30.0, streams, joints3d=joints)
    assert with_dropped(given).pictures == streams
    assert said(
        with_dropped(given), "is out of step from frame 3 on: joints in space are numbered as frames are in the"
    )
    assert [s.numbers for s in with_dropped(replace(given, joints3d=None)).pictures] == [WHOLE, DROPPED]


def test_frames_that_come_at_uneven_times_are_counted_and_it_is_said_from_where_on(tmp_path: Path) -> None:
    """A gap of one and a half usual ones does not tell whether an instant is lacking."""
    films(tmp_path, ".mp4")
    film(tmp_path / "cam1.mp4", range(6), [0, 33, 67, 120, 153, 186])
    capture = find(tmp_path, frame_rate=30)
    assert capture.pictures[1].numbers == tuple(range(6))
    (told,) = said(capture, "ms apart")
    assert told.startswith("camera cam1: frames are 33.0 to 53.0 ms apart")
    assert "off from frame 3 on" in told


def test_rates_at_which_cameras_part_are_said_with_when(tmp_path: Path) -> None:
    for name, rate in zip(NAMES, (30, Fraction(30000, 1001), 30), strict=True):
        counting_clip(tmp_path / f"{name}.mp4", 5, ring.SIZE, rate=rate)
    kalibr(tmp_path)
    (told,) = said(find(tmp_path), "rates differ")
    assert told.startswith(
        "rates differ: 29.97 frames/s of cam1, 30 frames/s of cam0, cam2; slowest and fastest are a frame apart after"
        " 33.4 s"
    )
    assert not said(find(tmp_path, frame_rate=30), "rates differ")
    counting_clip(tmp_path / "cam1.mp4", 5, ring.SIZE, rate=30)
    assert not said(find(tmp_path), "rates differ")


def test_short_videos_whose_times_tremble_are_in_step(tmp_path: Path) -> None:
    """Rates of 12 frames that come 0.8 ms off are 2 % apart, and part by a fifth of a frame in all; of 48 frames, 24
    and 25 a second part by two."""
    off = np.random.default_rng(0).normal(0, 0.8, (3, 12))
    for name, late in zip(NAMES, off, strict=True):
        film(tmp_path / f"{name}.mp4", range(12), [round(1000 * i / 30 + late[i] - late[0]) for i in range(12)])
    kalibr(tmp_path)
    capture = find(tmp_path)
    assert capture.frame_rate == pytest.approx(30, rel=0.02)
    assert [s.numbers for s in capture.pictures] == [tuple(range(12))] * 3
    for name, rate in zip(NAMES, (24, 25, 25), strict=True):
        counting_clip(tmp_path / f"{name}.mp4", 48, ring.SIZE, rate=rate)
    with pytest.raises(SourceError, match="camera cam1 runs at 25 frames/s and camera cam0 at 24"):
        find(tmp_path)


def test_rates_far_apart_are_refused_and_an_option_does_not_hide_them(tmp_path: Path) -> None:
    for name, rate in zip(NAMES, (15, 30, 15), strict=True):
        counting_clip(tmp_path / f"{name}.mp4", 5, ring.SIZE, rate=rate)
    kalibr(tmp_path)
    with pytest.raises(SourceError, match=r"cam1 runs at 30 frames/s and camera cam0 at 15; .* convert all videos to"):
        find(tmp_path)
    capture = find(tmp_path, frame_rate=15)
    (told,) = said(capture, "rates differ")
    assert told.startswith(
        "rates differ: 15 frames/s of cam0, cam2, 30 frames/s of cam1; slowest and fastest are a frame apart after"
        " 0.0667 s"
    )
    assert "frame_rate=15 is right where the files say it wrongly; where they do not, convert all videos" in told
    assert capture.frame_rate == 15


def test_a_video_whose_rows_are_two_instants_is_named(tmp_path: Path) -> None:
    for name in NAMES:
        counting_clip(tmp_path / f"{name}.mp4", 3, ring.SIZE, **({"x264-params": "tff=1"} if name == "cam1" else {}))
    kalibr(tmp_path)
    (told,) = said(find(tmp_path), "interlaced")
    assert told.startswith("interlaced: cam1; odd and even rows are two instants")
    assert "deinterlace all cameras alike (ffmpeg -i IN -vf bwdif=mode=send_frame OUT)" in told


@pytest.mark.parametrize("wide", [("cam1",), NAMES])
def test_cameras_of_high_dynamic_range_are_named(tmp_path: Path, wide: tuple[str, ...]) -> None:
    tags = {"colorspace": 9, "color_trc": 18, "color_primaries": 9}
    for name in NAMES:
        counting_clip(tmp_path / f"{name}.mp4", 3, ring.SIZE, tags=tags if name in wide else None)
    kalibr(tmp_path)
    (told,) = said(find(tmp_path), "high dynamic range")
    assert all((f"{n} (HLG, BT.2020)" in told) == (n in wide) for n in NAMES)
    assert ("the other cameras film otherwise" in told) == (len(wide) < len(NAMES))


def walker(instant: float) -> np.ndarray:
    """[h, w] luma of somebody who comes by before a wall."""
    width, height = ring.SIZE
    picture = np.tile(np.linspace(60, 120, width), (height, 1)).astype(np.uint8)
    left = round(3 * instant) % (width - 16)
    picture[4:-4, left : left + 16] = 200
    return picture


def walks(base: Path, instants: Sequence[float], second: float = 0.0) -> Capture:
    """A capture whose cam1 shows these instants, the rows in between one that is `second` later; the others show
    instants 0, 1, ..."""
    for name in NAMES:
        pictures = [walker(i) for i in (instants if name == "cam1" else range(len(instants)))]
        if name == "cam1" and second:
            for picture, i in zip(pictures, instants, strict=True):
                picture[1::2] = walker(i + second)[1::2]
        write_clip(base / f"{name}.mp4", [planes(p) for p in pictures], g=12)
    kalibr(base)
    return find(base)


@pytest.mark.parametrize(
    ("instants", "told"),
    [
        ([i // 2 * 2 for i in range(30)], r"12 of 23 .* in which it is new, 2, 4, "),
        ([i // 3 * 3 for i in range(30)], r"16 of 23 .* in which it is new, 3, 6, "),
        ([i * 5 // 6 for i in range(30)], r"4 of 23 .*leave it out \(views\.sources\)$"),
    ],
    ids=["15 of 30", "10 of 30", "25 of 30"],
)
def test_a_camera_whose_pictures_are_repeated_is_told_and_where_they_are_new(
    tmp_path: Path, instants: list[float], told: str
) -> None:
    (note,) = said(walks(tmp_path, instants), "once more")
    assert note.startswith("cam1: ")
    assert re.search(told, note), note


@pytest.mark.parametrize(
    "instants",
    [
        [float(i) for i in range(30)],
        [0.3 * i for i in range(30)],
        [min(i, 15) for i in range(30)],
        [i if i < 10 else max(10, i - 8) for i in range(30)],
        [i // 8 * 4 + min(i % 8, 3) for i in range(30)],
        [0] * 30,
    ],
    ids=["walks", "slowly", "stands still at last", "in between", "now and then", "throughout"],
)
def test_somebody_who_walks_slowly_or_stands_still_is_no_repeated_picture(
    tmp_path: Path, instants: list[float]
) -> None:
    capture = walks(tmp_path, instants)
    assert not said(capture, "once more")
    assert not said(capture, "interlaced")


def test_combed_rows_are_told_of_a_video_that_does_not_say_so(tmp_path: Path) -> None:
    (note,) = said(walks(tmp_path, range(30), second=1.0), "interlaced")
    assert note.startswith("interlaced: cam1, though the file does not say so: edges of what moves are combed")
    assert "(ffmpeg -i IN -vf bwdif=mode=send_frame OUT)" in note


def test_pixels_that_are_not_square_are_said_where_the_calibration_is_of_them(tmp_path: Path) -> None:
    films(tmp_path, ".mp4", WHOLE)
    width, height = ring.SIZE
    film(tmp_path / "cam1.mp4", WHOLE, aspect=Fraction(4, 3))
    capture = find(tmp_path)
    assert capture.pictures[1].size == ring.SIZE
    (told,) = said(capture, "not square")
    assert f"camera cam1: its pixels are not square, so players show {width}x{height} px as" in told
    film(tmp_path / "cam1.mp4", WHOLE, aspect=Fraction(1000, 1001))
    assert not said(find(tmp_path), "not square"), "what scaling to whole pixels leaves is no aspect"


def test_an_avi_that_is_cut_off_is_refused_whatever_it_dropped(tmp_path: Path) -> None:
    whole = film(tmp_path / "whole.avi", DROPPED)
    assert VideoFile(whole).count == len(DROPPED)
    raw = whole.read_bytes()
    (tmp_path / "cut.avi").write_bytes(raw[: raw.index(b"movi") + (len(raw) - raw.index(b"movi")) // 2])
    with pytest.raises(SourceError, match=r"cut\.avi is cut off: it promises 12 frames and holds"):
        VideoFile(tmp_path / "cut.avi")
