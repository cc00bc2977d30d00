"""Videos in step by their timecodes: drop-frame arithmetic, the law of the cut, and what cannot be brought together."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from posegaussian.storage.importers.timecode import parsed
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from posegaussian.storage.readers.video import VideoFile
from tests.storage.importers.test_videos import NAMES, find, kalibr
from tests.support import ring
from tests.support.video_clips import copied, counted, counting_clip

NTSC = Fraction(30000, 1001)


def label(frames: int, drop: bool = True) -> str:
    """The timecode of a frame since midnight at 29.97, by counting labels minute by minute."""
    if not drop:
        return f"{frames // 108000:02d}:{frames // 1800 % 60:02d}:{frames // 30 % 60:02d}:{frames % 30:02d}"
    minute = 0
    while frames >= (length := 1800 if minute % 10 == 0 else 1798):
        frames -= length
        minute += 1
    frames += 0 if minute % 10 == 0 else 2
    return f"{minute // 60:02d}:{minute % 60:02d}:{frames // 30:02d};{frames % 30:02d}"


def films(
    base: Path, starts: dict[str, tuple[int, int]], drop: bool = True, rate: Fraction = NTSC, **more: str
) -> None:
    """A scene's frame s + i is the grey s + i: camera NAME films `count` frames from `start` on."""
    base.mkdir(parents=True, exist_ok=True)
    for name in NAMES:
        first, count = starts.get(name, (0, 8))
        given = {"timecode": more.get(name, label(107888 + first, drop))}
        if given["timecode"] == "":
            given = {}
        counting_clip(base / f"{name}.mp4", count, ring.SIZE, first=first, rate=NTSC, **given)
    kalibr(base)


def seen(capture: Capture) -> dict[int, list[int | None]]:
    """{source frame: the scene's frame that each camera shows}."""
    source, out = open_source(capture, "pictures"), {}
    for n in capture.numbers.tolist():
        shown: list[int | None] = []
        for v, stream in enumerate(capture.pictures):
            shown.append(counted(next(iter(source.read(v, [n])))) if n in stream.numbers else None)
        out[n] = shown
    return out


def test_drop_frame_labels_are_counted() -> None:
    """One hour is 107892 frames; every label that exists is one more than the one before."""
    known = {
        "01:00:00;00": 107892,
        "00:01:00;02": 1800,
        "00:10:00;00": 17982,
        "00:00:59;29": 1799,
        "1:00:00;00": 107892,
    }
    for text, frames in known.items():
        found = parsed(text, 30 * 1000 / 1001)
        assert found is not None
        assert (found.frames, found.drop) == (frames, True)
    for frames in [*range(1790, 1810), *range(17975, 17990), 107891, 2589407]:
        found = parsed(label(frames), 30 * 1000 / 1001)
        assert found is not None
        assert found.frames == frames
    at_60 = parsed("01:00:00;00", 60 * 1000 / 1001)
    assert at_60 is not None
    assert at_60.frames == 215784
    plain = parsed("01:00:00:00", 25.0)
    assert plain is not None
    assert (plain.frames, plain.drop) == (90000, False)


@pytest.mark.parametrize(
    ("text", "rate"),
    [("", 30), ("now", 30), ("24:00:00:00", 30), ("00:60:00:00", 30), ("00:00:00:30", 30), ("00:01:00;00", 29.97),
     ("00:00:00;00", 25), ("00:00:00;00", 30.0), ("-1:00:00:00", 30), ("00:00:00:00", 0)],
)  # fmt: skip
def test_what_is_no_timecode_at_that_rate(text: str, rate: float) -> None:
    assert parsed(text, rate) is None


@pytest.mark.parametrize("suffix", ["mp4", "mov", "mkv", "avi"])
def test_a_file_s_timecode_is_read(tmp_path: Path, suffix: str) -> None:
    path = counting_clip(tmp_path / f"a.{suffix}", 3, rate=NTSC, timecode="01:00:00;00")
    assert VideoFile(path).timecode == "01:00:00;00"
    assert VideoFile(counting_clip(tmp_path / f"b.{suffix}", 3)).timecode is None


@pytest.mark.parametrize("drop", [True, False])
def test_every_instant_is_one_instant_of_the_scene(tmp_path: Path, drop: bool) -> None:
    """Across the hour, where a drop-frame label jumps; frames that some cameras lack stay."""
    films(tmp_path, {"cam0": (2, 8), "cam1": (0, 9), "cam2": (5, 7)}, drop)
    capture = find(tmp_path)
    shown = seen(capture)
    assert list(shown) == list(range(12))
    for n, frames in shown.items():
        assert frames == [n if a <= n < b else None for a, b in ((2, 10), (0, 9), (5, 12))]
    kind = "drop-frame" if drop else "non-drop"
    assert any(
        n.startswith(f"timecode ({kind}): cam1 begins at 00:59:5") and "cam0 by 2, cam2 by 5 frames" in n
        for n in capture.notes
    )


def test_cutting_a_beginning_and_its_timecode_alike_changes_no_picture(tmp_path: Path) -> None:
    """The law: k frames less in front and a timecode k later show the same at every instant that is left."""
    films(tmp_path / "whole", {"cam0": (2, 8), "cam1": (0, 9), "cam2": (5, 7)})
    whole = seen(find(tmp_path / "whole"))
    for cut in (1, 3):
        films(tmp_path / f"{cut}", {"cam0": (2 + cut, 8 - cut), "cam1": (0, 9), "cam2": (5, 7)})
        shown = seen(find(tmp_path / f"{cut}"))
        assert {n: f[1:] for n, f in shown.items()} == {n: f[1:] for n, f in whole.items()}
        for n, f in shown.items():
            assert f[0] == (whole[n][0] if n >= 2 + cut else None)


def test_masks_go_with_their_pictures(tmp_path: Path) -> None:
    films(tmp_path, {"cam0": (2, 8), "cam1": (0, 9), "cam2": (5, 7)})
    for v, name in enumerate(NAMES):
        for n in range(3):
            ring.write_mask(tmp_path / "masks" / name / f"{n:06d}.png", v, n)
    masks = find(tmp_path).streams("masks")
    assert [s.numbers for s in masks if s] == [(2, 3, 4), (0, 1, 2), (5, 6, 7)]


def test_midnight_may_lie_between_two_beginnings(tmp_path: Path) -> None:
    films(tmp_path, {}, cam0="23:59:59;28", cam1="00:00:00;01", cam2="23:59:59;29")
    assert [s.numbers[0] for s in find(tmp_path).pictures] == [0, 3, 1]


def test_what_cannot_be_brought_together_gets_a_sentence(tmp_path: Path) -> None:
    films(tmp_path / "kinds", {}, cam0="01:00:00;00", cam1="01:00:00:00")
    with pytest.raises(UserError, match=r"counts drop-frame \(01:00:00;00\) and camera .* does not .*3.6 s an hour"):
        find(tmp_path / "kinds")
    films(tmp_path / "apart", {}, cam0="02:00:00;00")
    with pytest.raises(UserError, match=r"no instant in common: camera cam1 .* were the clocks set alike"):
        find(tmp_path / "apart")
    assert [s.numbers[0] for s in find(tmp_path / "apart", timecode="ignore").pictures] == [0, 0, 0]
    films(tmp_path / "rates", {"cam0": (1, 8)}, drop=False)
    counting_clip(tmp_path / "rates" / "cam2.mp4", 8, ring.SIZE, rate=30, timecode="01:00:00:02")
    with pytest.raises(UserError, match=r"different frame rates cannot be brought into step: .* runs at 29.97"):
        find(tmp_path / "rates")


def test_timecodes_of_some_or_broken_ones_are_said_and_not_used(tmp_path: Path) -> None:
    films(tmp_path / "some", {"cam0": (2, 8)}, cam1="")
    capture = find(tmp_path / "some")
    assert "timecode: cam0, cam2 carry one and cam1 not, so videos are taken to begin together" in capture.notes
    assert {s.numbers for s in capture.pictures} == {tuple(range(8))}
    films(tmp_path / "none", {}, cam0="", cam1="", cam2="")
    assert not any(n.startswith("timecode") for n in find(tmp_path / "none").notes)


CUT = 15
"""Frame of the scene at which the copies below are cut."""
KEYS = {"cam0": 12, "cam1": 20, "cam2": 5}
"""Frames between keyframes: after the cut the next come 9, 5 and 0 frames late."""


def cuts(base: Path, suffix: str, counts: tuple[int, int, int] = (40, 40, 40), **options: str) -> Path:
    """Videos as `ffmpeg -i IN -ss 0.5 -c copy OUT` cuts them: each from its next keyframe on, and shown as late."""
    base.mkdir(parents=True)
    (base.parent / "whole").mkdir(exist_ok=True)
    for (name, g), count in zip(KEYS.items(), counts, strict=True):
        whole = base.parent / "whole" / f"{name}.mp4"
        counting_clip(whole, count, ring.SIZE, crf=1, g=g, keyint_min=g, sc_threshold=0, bf=2)
        copied(whole, base / f"{name}{suffix}", CUT, CUT, **options)
    kalibr(base)
    return base


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_copies_that_were_cut_at_one_instant_stay_in_step_though_they_begin_at_other_keyframes(
    tmp_path: Path, suffix: str
) -> None:
    base = cuts(tmp_path / "cut", suffix)
    capture = find(base)
    assert [s.numbers[0] for s in capture.pictures] == [9, 5, 0]
    for n, shown in seen(capture).items():
        assert {s for s in shown if s is not None} == {n + CUT}
    assert sum("files show their first frame late: cam0 by 9, cam1 by 5 frames, and" in n for n in capture.notes) == 1
    assert "camera cam0 lacks pictures of 9 frames (0-8)" in capture.notes
    assert [s.numbers[0] for s in find(base, timecode="ignore").pictures] == [0, 0, 0]


def test_cameras_with_as_many_frames_are_not_moved_by_clocks_of_files_that_began_by_themselves(tmp_path: Path) -> None:
    """Phones begin a file with its sound, and pictures when the first is there."""
    capture = find(cuts(tmp_path / "together", ".mp4", (49, 45, 40)))
    assert {s.numbers for s in capture.pictures} == {tuple(range(25))}
    (told,) = (n for n in capture.notes if n.startswith("files show"))
    assert told.startswith("files show their first frame late: cam0 by 9, cam1 by 5 frames; videos are taken to begin")
    assert "as all have 25 frames, as cameras have that are started and stopped together" in told
    assert told.endswith("set frames.time_offset: {cam0: -9, cam1: -5}")


def test_files_that_have_no_instant_in_common_are_not_moved(tmp_path: Path) -> None:
    capture = find(cuts(tmp_path / "apart", ".mp4", (40, 40, 19)))
    assert [s.numbers[0] for s in capture.pictures] == [0, 0, 0]
    assert any("taken to begin together, as they would have no instant in common" in n for n in capture.notes)


def test_frames_that_are_reordered_do_not_begin_late_without_an_edit_list(tmp_path: Path) -> None:
    """Fragments, as OBS writes them: the first of B-frames is shown at 2 / 30 s by its times, that of others at 0."""
    (tmp_path / "whole").mkdir()
    for bf, name in zip((0, 2, 2), NAMES, strict=True):
        whole = counting_clip(tmp_path / "whole" / f"{name}.mp4", 12 - bf, ring.SIZE, crf=1, bf=bf)
        parts = copied(whole, tmp_path / f"{name}.mp4", movflags="frag_keyframe+empty_moov")
        assert VideoFile(parts).seconds[0] == pytest.approx(bf / 30)
        assert VideoFile(parts).begins == 0
    kalibr(tmp_path)
    assert [s.numbers[0] for s in find(tmp_path).pictures] == [0, 0, 0]


def test_what_sound_leads_by_in_a_matroska_file_is_no_late_beginning(tmp_path: Path) -> None:
    whole = counting_clip(tmp_path / "whole.mp4", 12, ring.SIZE)
    assert VideoFile(copied(whole, tmp_path / "sound.mkv", -0.023 * 30)).begins == 0
    assert VideoFile(copied(whole, tmp_path / "late.mkv", -1)).begins == pytest.approx(1 / 30, abs=1e-3)
