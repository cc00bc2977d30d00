"""The containers of videos: what one holds, counted packet by packet without decoding, and whether it is cut off."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.plausible import check_picture

_SHORT_SECONDS, _SHORT_SHARE = 0.5, 0.01
"""A file that lacks more than both, of the time that it says it lasts, is not whole: ends are rounded to frames."""
_SOUND_LEAD = 0.03
"""Seconds by which a sound track begins before time 0 as its encoder needs; Matroska then writes all pictures later."""


@contextmanager
def opened(path: str | Path, **options: str) -> Iterator[tuple[Any, Any]]:
    """(container, first video stream) decoding on one thread, with options of the demuxer; every decoder error becomes
    a SourceError."""
    import av
    import av.error
    import av.logging

    av.logging.set_level(av.logging.PANIC)
    try:
        with av.open(str(path), metadata_errors="replace", options=options) as container:
            if not container.streams.video:
                raise SourceError(f"{path} holds no video stream")
            stream = container.streams.video[0]
            if stream.codec_context is None:
                raise SourceError(
                    f"video {path} is of a codec that is not known here; write it again, for example in H.264"
                )
            if stream.codec_context.width:
                check_picture(f"video {path}", stream.codec_context.width, stream.codec_context.height)
            stream.codec_context.thread_count = 1
            yield container, stream
    except av.error.FFmpegError as e:
        raise SourceError(f"cannot read video {path}: {e.strerror or e}; it is damaged, cut off or not a video") from e


@dataclass(frozen=True)
class Contents:
    """What a container holds of its first video, without decoding."""

    packets: list[tuple[int | None, int | None, bool, bool]]
    """(presentation time, decode time, whether key, whether an edit list leaves it out), in order of decoding."""
    base: float
    """Seconds of a unit of time."""
    rates: list[float]
    """Frames per second as the file names them; the first is the average one."""
    timecode: str | None
    """The first frame's, as the file has it."""
    aspect: float
    """A pixel's width over its height."""
    begins: float
    """Seconds after the file's beginning at which its first frame is shown, where the file was told so; else 0."""
    perhaps_cut: tuple[float, float] | None
    """(seconds held, seconds said to be held) where the file may be cut off."""


def contents(path: str) -> Contents:
    """Read a container once, all packets of all its streams. Raises SourceError where it is cut off."""
    packets, corrupt, last, end = [], 0, 0, 0.0
    with opened(path) as (container, stream):
        for p in container.demux():
            if p.size and p.time_base and p.pts is not None:
                end = max(end, float((p.pts + (p.duration or 0)) * p.time_base))
            if p.size and p.stream.index == stream.index:
                packets.append((p.pts, p.dts, p.is_keyframe, p.is_discard))
                corrupt += p.is_corrupt
                last = max(last, (p.dts if p.pts is None else p.pts) or 0)
        base, promised, kind = float(stream.time_base), stream.frames, container.format.name
        rates = [float(r) for r in (stream.average_rate or stream.guessed_rate, stream.guessed_rate) if r]
        timecode, aspect = _timecode(container, stream), float(stream.sample_aspect_ratio or 1)
        tagged = _tagged_seconds(stream) if "matroska" in kind else None
        said = (container.duration or 0) / 1e6 if "matroska" in kind and tagged is None else 0.0
    # AVI counts time in frames, and promises those, too, that were dropped: nothing is stored of them.
    held = last + 1 if kind == "avi" else len(packets)
    begins = _begins(path, kind, packets, base)
    if held < promised:
        held = max(held, _stored(path))
    whole, ends = len(packets) - corrupt, base * last + (1 / rates[0] if rates else 0)
    told = f"it promises {promised} frames and holds {whole} whole ones; copy it again"
    if corrupt and not promised:
        told = f"it ends within a frame, after {whole} whole ones; copy it again"
    elif tagged is not None:
        told = (
            f"it says that it lasts {tagged:.1f} s and ends after {ends:.1f} s; copy it again or, where it is whole,"
            " write it anew (ffmpeg -i IN -c copy OUT)"
        )
    if corrupt or held < promised or _lacks(ends, tagged or 0):
        raise SourceError(f"video {path} is cut off: {told}")
    return Contents(packets, base, rates, timecode, aspect, begins, (end, said) if _lacks(end, said) else None)


def _stored(path: str) -> int:
    """Frames that an MP4 holds, those included that its edit list leaves out, so that the demuxer passes them over."""
    with opened(path, ignore_editlist="1") as (container, stream):
        return sum(bool(p.size) for p in container.demux(stream))


def _begins(path: str, kind: str, packets: list[tuple[int | None, int | None, bool, bool]], base: float) -> float:
    """What `Contents.begins` says. An MP4 is told so by an edit list alone: without one its first frame seems as late
    as frames are reordered. AVI is not told so."""
    first = base * min((p[0] for p in packets if p[0] is not None and not p[3]), default=0)
    if "matroska" in kind:
        return first if first > _SOUND_LEAD else 0.0
    if first <= 0 or "mp4" not in kind:
        return 0.0
    with opened(path, ignore_editlist="1") as (container, stream):
        unedited = next(((p.pts, p.dts) for p in container.demux(stream) if p.size), None)
    return first if unedited != packets[0][:2] else 0.0


def _lacks(end: float, lasts: float) -> bool:
    """Whether a file that ends after `end` seconds is too short for one that lasts so many."""
    return lasts - end > max(_SHORT_SECONDS, _SHORT_SHARE * lasts)


def _tagged_seconds(stream: Any) -> float | None:
    """How long a Matroska track lasts by its tag DURATION (`00:00:10.017`, of a language, too); None without one."""
    tag = next((v for k, v in stream.metadata.items() if k.upper().partition("-")[0] == "DURATION"), "")
    parts = re.fullmatch(r"(\d+):(\d+):(\d+(?:\.\d*)?)", str(tag))
    return int(parts[1]) * 3600 + int(parts[2]) * 60 + float(parts[3]) if parts else None


def _timecode(container: Any, stream: Any) -> str | None:
    """What the video, the whole file or a track of timecodes is tagged with, in that order."""
    tracks = [s for s in container.streams if s.type == "data"]
    tags = [(k.lower(), v) for m in (stream, container, *tracks) for k, v in m.metadata.items()]
    return next((str(v) for k, v in tags if k == "timecode"), None)
