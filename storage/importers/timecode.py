"""Timecodes bring videos into step: frame n of all is one label `HH:MM:SS:FF`.

Drop-frame timecode, written with a semicolon, leaves out labels so that it keeps up with the clock at 29.97 frames/s:
two a minute (four at 59.94), but in minutes that are tens (SMPTE ST 12-1). Frames are counted, labels are not.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from posegaussian.storage.importers.films import SAME_RATE
from posegaussian.storage.model.capture import PER_VIEW, Capture
from posegaussian.storage.model.documents import shortened
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.video import VideoFile

NTSC = 1000 / 1001
"""A drop-frame video's frames per second over its labels'."""
IGNORE = "the option timecode=ignore takes videos to begin together"


class Start(NamedTuple):
    """Where a video begins."""

    label: str
    """As written."""
    drop: bool
    """Whether labels are left out."""
    frames: int
    """Frames since midnight."""


def parsed(label: str, rate: float) -> Start | None:
    """A timecode at so many frames per second; None for a text that is none, or of another rate's labels."""
    found = re.fullmatch(r"([01]?\d|2[0-3]):([0-5]\d):([0-5]\d)([:;.])(\d{2,3})", label.strip())
    nominal = round(rate)
    if found is None or nominal < 1 or int(found[5]) >= nominal:
        return None
    hours, minutes, seconds, frame = (int(found[i]) for i in (1, 2, 3, 5))
    drop = found[4] != ":"
    at = ((60 * hours + minutes) * 60 + seconds) * nominal + frame
    if not drop:
        return Start(label, False, at)
    dropped = 2 * nominal // 30
    gone = minutes % 10 and seconds == 0 and frame < dropped  # a label that is left out
    if nominal % 30 or abs(rate - nominal * NTSC) > SAME_RATE * rate or gone:
        return None
    whole = 60 * hours + minutes
    return Start(label, True, at - dropped * (whole - whole // 10))


def in_step(capture: Capture, ignored: bool) -> Capture:
    """The capture of videos with the frames of each numbered from the earliest beginning, where all carry a timecode,
    and with sentences on what was done.

    Masks, joints and depth of a view go with its pictures. Raises SourceError for timecodes that cannot be brought
    together: of videos of different rates, of both kinds, or without an instant in common.
    """
    names, pictures = capture.rig.names, capture.pictures
    if len(names) < 2:
        return capture
    videos = {n: VideoFile(s.files[0].path) for n, s in zip(names, pictures, strict=True)}
    labels = {n: v.timecode for n, v in videos.items() if v.timecode is not None}
    if not labels:
        return capture
    why = _not_taken(capture, videos, labels, ignored)
    if why:
        return replace(capture, notes=(*capture.notes, f"timecode: {why}"))
    starts = {n: s for n, v in videos.items() if (s := parsed(labels[n], v.rate)) is not None}
    late = _offsets(starts, videos)
    return _later(capture, late, _told(starts, late))


def _later(capture: Capture, late: Mapping[str, int], told: str) -> Capture:
    """The capture with the frames of each camera numbered so much later, and with this sentence."""
    kinds = {
        kind: tuple(
            s if s is None else s.renumbered({k: k + late[n] for k in s.numbers})
            for n, s in zip(capture.rig.names, capture.streams(kind), strict=False)
        )
        for kind in PER_VIEW
    }
    return replace(capture, **kinds, notes=(*capture.notes, told))  # type: ignore[arg-type]


def as_files_begin(capture: Capture) -> Capture:
    """The capture of videos without timecodes in step by when their files show their first frames, with a sentence: a
    copy that was cut without encoding again begins at the keyframe after the cut, and its times say so.

    Clocks of files that began recording by themselves say nothing of one another. Cameras that are started and stopped
    together have as many frames each, those that were cut at one instant have not: where all have, none is moved.
    """
    videos = {n: VideoFile(s.files[0].path) for n, s in zip(capture.rig.names, capture.pictures, strict=True)}
    earliest = min(v.begins for v in videos.values())
    late = {n: round((v.begins - earliest) * capture.frame_rate) for n, v in videos.items()}
    if not any(late.values()) or any(v.timecode is not None for v in videos.values()):
        return capture
    ends = [s.numbers[-1] + 1 for s in capture.pictures]
    told = f"files show their first frame late: {', '.join(f'{n} by {k}' for n, k in late.items() if k)} frames"
    why = None
    if capture.joints3d is not None:
        why = "joints in space are numbered by other frames"
    elif len(set(ends)) == 1:
        why = f"all have {ends[0]} frames, as cameras have that are started and stopped together"
    elif max(late.values()) >= min(e + k for e, k in zip(ends, late.values(), strict=True)):
        why = "they would have no instant in common"
    if why is None:
        return _later(capture, late, f"{told}, and are numbered so; {IGNORE}; `inspect` measures what remains")
    offsets = ", ".join(f"{n}: {-k}" for n, k in late.items() if k)
    cure = f"where the files are right, set frames.time_offset: {{{offsets}}}"
    return replace(capture, notes=(*capture.notes, f"{told}; videos are taken to begin together, as {why}: {cure}"))


def _not_taken(
    capture: Capture, videos: Mapping[str, VideoFile], labels: Mapping[str, str], ignored: bool
) -> str | None:
    """Why timecodes are not used, where they are not. Raises SourceError for rates that differ."""
    together = "videos are taken to begin together"
    if ignored:
        return f"not used, as the option says; {together}"
    if without := [n for n in videos if n not in labels]:
        return f"{', '.join(labels)} carry one and {', '.join(without)} not, so {together}"
    if capture.joints3d is not None:
        return f"not used, as joints in space are numbered by other frames; {together}"
    rates = {n: v.rate for n, v in videos.items()}
    low, high = min(rates, key=rates.__getitem__), max(rates, key=rates.__getitem__)
    if len({*labels.values()}) > 1 and rates[high] > rates[low] * (1 + SAME_RATE):
        raise SourceError(
            f"timecodes of different frame rates cannot be brought into step: camera {low} runs at {rates[low]:g}"
            f" frames/s, camera {high} at {rates[high]:g}; give all one rate, or {IGNORE}"
        )
    unread = [n for n, v in videos.items() if parsed(labels[n], v.rate) is None]
    if unread:
        first = unread[0]
        return f"{shortened(labels[first])} of camera {first} is none at {videos[first].rate:g} frames/s, so {together}"
    return None


def _offsets(starts: Mapping[str, Start], videos: Mapping[str, VideoFile]) -> dict[str, int]:
    """{camera: frames by which it begins after the earliest}. Raises SourceError."""
    drop = [n for n, s in starts.items() if s.drop]
    if drop and len(drop) < len(starts):
        other = next(n for n in starts if n not in drop)
        raise SourceError(
            f"camera {drop[0]} counts drop-frame ({starts[drop[0]].label}) and camera {other} does not"
            f" ({starts[other].label}), which part by 3.6 s an hour; set all alike, or {IGNORE}"
        )
    rate = next(iter(videos.values())).rate
    day = parsed("23:59:59:00", rate)
    assert day is not None
    whole = day.frames + round(rate) - (144 * 18 * (round(rate) // 30) if drop else 0)
    at = {n: s.frames for n, s in starts.items()}
    if max(at.values()) - min(at.values()) > whole / 2:  # midnight lies between them
        at = {n: f + whole if f < whole / 2 else f for n, f in at.items()}
    earliest = min(at.values())
    late = {n: f - earliest for n, f in at.items()}
    last = max(late, key=late.__getitem__)
    ended = next((n for n in late if late[n] + videos[n].count <= late[last]), None)
    if ended is not None:
        raise SourceError(
            f"timecodes have no instant in common: camera {ended} begins at {starts[ended].label} and has"
            f" {videos[ended].count} frames, camera {last} begins at {starts[last].label}; were the clocks set alike?"
            f" {IGNORE[0].upper()}{IGNORE[1:]}"
        )
    return late


def _told(starts: Mapping[str, Start], late: Mapping[str, int]) -> str:
    first = min(late, key=late.__getitem__)
    kind = "drop-frame" if starts[first].drop else "non-drop"
    begin = f"timecode ({kind}): {first} begins at {starts[first].label}"
    if not any(late.values()):
        return f"{begin}, and so do all; `inspect` measures what remains"
    after = ", ".join(f"{n} by {k}" for n, k in late.items() if k)
    return f"{begin}, frames are numbered from there; later begin {after} frames; `inspect` measures what remains"
