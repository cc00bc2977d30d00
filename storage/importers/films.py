"""Videos, one a camera, whose frames of one number are one instant: streams, rates, and frames that were dropped.

A camera drops frames while it films: its file has none there and times that tell so. Its later frames are numbered by
their times, so that they stay in step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.common import ranges
from posegaussian.storage.model.capture import PER_VIEW, Capture, SourceFile, Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.video import LONG_GAP, VideoFile
from posegaussian.storage.readers.video_look import Seen, seen_in

_RATE_TOLERANCE = 0.01
_JITTER = 0.05
"""The same of short videos, whose times say their rate no better: in 12 frames whose times tremble by 0.8 ms it is off
by up to 1 %. 24 and 25 frames a second are told apart in eight frames."""
_TOGETHER = 0.25
"""Frames by which two such videos may part until the shorter one ends."""
_DEINTERLACE = "deinterlace all cameras alike (ffmpeg -i IN -vf bwdif=mode=send_frame OUT)"
SAME_RATE = 5e-4
"""Relative difference of frame rates below which frames of two videos stay in step; 29.97 and 30 differ by 1e-3."""


def video_streams(videos: Mapping[str, Path], frame_rate: float | None) -> tuple[list[Stream], float, list[str]]:
    """(streams, frames per second, notes) of one video a camera.

    Raises SourceError for a video that cannot be read, and for rates that differ by more than 1 %, or 5 % where the
    videos end before that is a quarter of a frame: frame n must be the same instant in every view.
    """
    opened = {name: VideoFile(p) for name, p in videos.items()}
    streams = [
        Stream("video", (SourceFile.of(videos[name]),), tuple(range(v.count)), v.size) for name, v in opened.items()
    ]
    rates = {name: v.rate for name, v in opened.items()}
    low, high = min(rates, key=rates.__getitem__), max(rates, key=rates.__getitem__)
    parted = (rates[high] / max(rates[low], 1e-9) - 1) * max(min(v.count for v in opened.values()) - 1, 0)
    tolerance = _JITTER if parted <= _TOGETHER else _RATE_TOLERANCE
    if frame_rate is None and rates[high] > rates[low] * (1 + tolerance):
        raise SourceError(
            f"camera {high} runs at {rates[high]:g} frames/s and camera {low} at {rates[low]:g}; frame n must be one"
            " instant: convert all videos to one rate, or, where the files say it wrongly, set frame_rate"
        )
    rate = frame_rate or rates[high]
    if rate <= 0:
        raise SourceError(f"video {opened[high].path} gives no frame rate; set frame_rate")
    notes = _drift(rates, frame_rate)
    return streams, rate, notes + [said for n, v in opened.items() for said in _unsteady(n, v, rate)]


def are_counted(capture: Capture) -> bool:
    """Whether all cameras are videos whose frames are numbered in the order of the file so far."""
    return all(s.kind == "video" and "indices" not in s.options for s in capture.pictures)


def with_dropped(capture: Capture) -> Capture:
    """The capture with the frames of videos numbered by their times where some were dropped, and with sentences on it.

    Masks, joints and depth of a view, which are numbered as the frames in its file, go with its pictures. Where joints
    in space are given, which are numbered so, too, numbers stay.
    """
    videos = {n: VideoFile(s.files[0].path) for n, s in zip(capture.rig.names, capture.pictures, strict=True)}
    periods = {n: v.periods for n, v in videos.items() if v.periods is not None}
    notes = tuple(_lacking(n, p, capture.joints3d is None) for n, p in periods.items())
    if capture.joints3d is not None or not periods:
        return replace(capture, notes=(*capture.notes, *notes))
    kinds = {
        kind: tuple(
            s if s is None or n not in periods else s.renumbered(dict(enumerate(periods[n])))
            for n, s in zip(capture.rig.names, capture.streams(kind), strict=False)
        )
        for kind in PER_VIEW
    }
    return replace(capture, **kinds, notes=(*capture.notes, *notes))  # type: ignore[arg-type]


def as_filmed(capture: Capture) -> list[str]:
    """Sentences about how videos were filmed: that rows are two instants, as the file says or its pictures show, that
    pictures are repeated, that colours are of more than standard range, that pixels are not square, and that a file
    lasts longer than what it holds."""
    videos = {
        name: VideoFile(s.files[0].path)
        for name, s in zip(capture.rig.names, capture.pictures, strict=True)
        if s.kind == "video"
    }
    seen = {n: looked for n, v in videos.items() if (looked := seen_in(v)) is not None}
    notes = []
    if fields := [n for n, v in videos.items() if v.interlaced]:
        notes.append(
            f"interlaced: {', '.join(fields)}; odd and even rows are two instants, unless they were filmed as one:"
            f" where edges of what moves are combed, {_DEINTERLACE}"
        )
    if combed := [n for n in seen if seen[n].combed and n not in fields]:
        notes.append(
            f"interlaced: {', '.join(combed)}, though the file does not say so: edges of what moves are combed, as odd"
            f" and even rows are two instants; {_DEINTERLACE}"
        )
    notes += _repeated({n: s for n, s in seen.items() if s.repeats})
    if wide := [f"{n} ({v.wide_color})" for n, v in videos.items() if v.wide_color is not None]:
        notes.append(
            f"high dynamic range or wide gamut: {', '.join(wide)}; brought to sRGB by one fixed curve"
            + ("; the other cameras film otherwise, set all alike" if len(wide) < len(videos) else "")
        )
    for name, v in videos.items():
        if v.perhaps_cut is not None:
            held, said = v.perhaps_cut
            notes.append(
                f"camera {name}: the file says that it lasts {said:.1f} s and ends after {held:.1f} s; it may be cut"
                " off: copy it again, unless it ends where the others do"
            )
        if v.square_size != v.size:
            stored, shown = ("x".join(map(str, size)) for size in (v.size, v.square_size))
            notes.append(
                f"camera {name}: its pixels are not square, so players show {stored} px as {shown} px; pictures are"
                " taken as they are stored, as the calibration must be"
            )
    return notes


def _repeated(seen: Mapping[str, Seen]) -> list[str]:
    """A sentence on cameras whose pictures are repeated, those together of which the same is seen."""
    cameras: dict[Seen, list[str]] = {}
    for name, of_camera in seen.items():
        cameras.setdefault(of_camera, []).append(name)
    return [_repeats(" and ".join(names), of_them) for of_them, names in cameras.items()]


def _repeats(names: str, seen: Seen) -> str:
    """That sentence."""
    of = f"{len(seen.repeats)} of {len(seen.frames) - 1} pictures from frame {seen.frames[1]} on"
    told = (
        f"{names}: {of} are the one before once more, as where fewer frames a second are filmed than written; beside"
        " cameras that film all of them it shows what moves late there: film at the rate of the others, or leave it out"
        " (views.sources)"
    )
    if (new := seen.every) is None:
        return told
    return f"{told}, or work on the frames in which it is new, {new[0]}, {new[1]}, ... (frames.range)"


def _drift(rates: Mapping[str, float], given: float | None) -> list[str]:
    """The sentence about cameras whose rates differ so much that they part; with a rate that is `given`, so much that
    without it they would be refused."""
    low, high = min(rates.values()), max(rates.values())
    if high <= low * (1 + (SAME_RATE if given is None else _RATE_TOLERANCE)):
        return []
    each = {f"{r:.4g}": [n for n in rates if f"{rates[n]:.4g}" == f"{r:.4g}"] for r in sorted(rates.values())}
    told = ", ".join(f"{rate} frames/s of {', '.join(names)}" for rate, names in each.items())
    apart = float(f"{1 / (high - low):.3g}")
    next_step = "convert all videos to one rate, or, where the files say it wrongly, set frame_rate"
    if given is not None:
        next_step = (
            f"frame_rate={given:g} is right where the files say it wrongly; where they do not, convert all videos to"
            " one rate"
        )
    said = (
        f"rates differ: {told}; slowest and fastest are a frame apart after {apart:g} s, and frame n is taken as"
        f" one instant: {next_step}"
    )
    return [said]


def _unsteady(name: str, video: VideoFile, rate: float) -> list[str]:
    """The sentence about a video whose frames are not evenly spaced, for another reason than that some were dropped."""
    gaps = np.diff(video.seconds)
    if video.periods is not None or not len(gaps) or gaps.max() <= LONG_GAP * gaps.min():
        return []
    at = int(np.argmax(gaps > LONG_GAP * gaps.min())) + 1
    said = (
        f"camera {name}: frames are {1000 * gaps.min():.1f} to {1000 * gaps.max():.1f} ms apart; time is taken as"
        f" frame / {rate:g}, which is off from frame {at} on; convert the video to a constant rate"
    )
    return [said]


def _lacking(name: str, periods: tuple[int, ...], numbered: bool) -> str:
    """The sentence about frames that a camera dropped."""
    dropped = np.setdiff1d(np.arange(periods[-1] + 1), periods)
    told = f"camera {name} dropped {dropped.size} frames while it filmed ({ranges(dropped)})"
    if numbered:
        return f"{told}; its later frames are numbered by their times"
    return (
        f"{told}, and is out of step from frame {int(dropped[0])} on: joints in space are numbered as frames are in the"
        " files, so numbers stay; leave those joints away, or that camera"
    )
