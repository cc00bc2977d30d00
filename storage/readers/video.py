"""Video in, through PyAV: exact frame counts, exact random access, explicit colour.

Colour: a matrix or range that the file names is honoured. Where it names none, pictures of 720 lines or more are BT.709
and smaller ones BT.601, limited range (yuvj formats are full range). Decoded values are display-referred and taken as
sRGB; high dynamic range (HLG, PQ) and wide gamut (BT.2020, Display P3) are brought to it by
`posegaussian.storage.readers.wide_color`, other primaries refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.model.documents import regular
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.video_container import contents, opened
from posegaussian.storage.readers.wide_color import BT2020, WideColor

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm")
"""File endings that count as videos, lower case."""

LONG_GAP = 1.5
"""Times the usual gap between frames from which on a gap is a long one."""
_OFF_MULTIPLE = 0.2
"""Usual gaps by which a long one may miss a whole number of them: clocks of cameras and times in ms are that exact."""
_SEEK_GAP = 48
"""Frames ahead above which seeking is tried instead of decoding on; usual distance of keyframes."""
# ITU-T H.273 matrix coefficients -> the value PyAV's Colorspace has for swscale.
_MATRICES = {1: 1, 4: 4, 5: 5, 6: 5, 7: 7, 9: 9}
_UNSPECIFIED = 2
_UNREAD_PRIMARIES = (8, 10, 11)
"""Film, XYZ and the DCI's P3, whose whites are others."""
_PREDICTED = (2, 3)
"""Types of pictures that others are needed for, P and B, as PyAV's PictureType has them."""


@dataclass(frozen=True)
class _Index:
    count: int
    size: tuple[int, int]
    rate: float
    quarter_turns: int
    pts: tuple[int, ...] | None
    """Presentation time of every frame, ascending; None where the container gives none, then frames are counted."""
    keys: tuple[tuple[int, int], ...]
    """(frame index, decode time) of every keyframe, ascending."""
    seconds: np.ndarray
    """[count] when each frame is shown, ascending; empty where the container gives no times."""
    periods: tuple[int, ...] | None
    """As the property of `VideoFile`."""
    timecode: str | None
    """As the file has it."""
    begins: float
    """As the property of `VideoFile`."""
    square_size: tuple[int, int]
    """As the property of `VideoFile`."""
    interlaced: bool
    """As the property of `VideoFile`."""
    wide_color: str | None
    """As the property of `VideoFile`."""
    perhaps_cut: tuple[float, float] | None
    """As the property of `VideoFile`."""


class VideoFile:
    """One video: its frames by 0-based index in order of presentation.

    Opening it reads the container once, without decoding more than a frame, and remembers the result while the file is
    unchanged. Raises SourceError for files that are missing, hold no video, are cut off or have colours that are
    refused.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        stat = regular(self.path, "video")
        if not stat.st_size:
            raise SourceError(f"video {self.path} is empty, 0 bytes; copy or record it again")
        self._index = _scan(str(self.path), stat.st_size, stat.st_mtime_ns)

    @property
    def count(self) -> int:
        """Number of frames, counted."""
        return self._index.count

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) px as shown, after the rotation the file asks for."""
        return self._index.size

    @property
    def rate(self) -> float:
        """Frames per second, on average; of a video that lacks frames, as if they were there."""
        return self._index.rate

    @property
    def seconds(self) -> np.ndarray:
        """[count] when each frame is shown, ascending; empty where the file does not say."""
        return self._index.seconds

    @property
    def periods(self) -> tuple[int, ...] | None:
        """By how many frames each frame comes after the first, counting those that were dropped between them; None
        where none was, or where times do not tell."""
        return self._index.periods

    @property
    def timecode(self) -> str | None:
        """The first frame's timecode as the file has it, of a tmcd track or a tag; None where it has none."""
        return self._index.timecode

    @property
    def begins(self) -> float:
        """Seconds after the file's beginning at which its first frame is shown, where an MP4's edit list or Matroska's
        times say so; else 0."""
        return self._index.begins

    @property
    def square_size(self) -> tuple[int, int]:
        """(width, height) px as players show it: `size`, unless the file says that its pixels are not square."""
        return self._index.square_size

    @property
    def interlaced(self) -> bool:
        """Whether odd and even rows of its first frame are stored as two fields, which are two instants where they
        were filmed so."""
        return self._index.interlaced

    @property
    def wide_color(self) -> str | None:
        """What its colours are that are brought to sRGB, in words: `HLG, BT.2020`; None of standard range and gamut."""
        return self._index.wide_color

    @property
    def keyframes(self) -> tuple[int, ...]:
        """Frames from which decoding can begin, ascending; empty where the file does not say."""
        return tuple(frame for frame, _ in self._index.keys)

    @property
    def perhaps_cut(self) -> tuple[float, float] | None:
        """(seconds that the file holds, seconds that it says it lasts) where so much lacks that it may be cut off."""
        return self._index.perhaps_cut

    def read(self, numbers: Sequence[int] | np.ndarray) -> Iterator[np.ndarray]:
        """[h, w, 3] uint8 sRGB for each of the strictly ascending frame indices, decoded as they are asked for.

        Raises SourceError for an index the video does not have and for a frame that cannot be decoded.
        """
        for frame in self._frames(numbers):
            yield _to_rgb(frame, self._index.quarter_turns, self.path)

    def stored_grey(self, numbers: Sequence[int] | np.ndarray) -> Iterator[np.ndarray]:
        """[h, w] uint8 brightness of the same as it is stored, not rotated, at a third of the time. Raises as `read`
        does."""
        for frame in self._frames(numbers):
            yield frame.reformat(format="gray", threads=1).to_ndarray()

    def _frames(self, numbers: Sequence[int] | np.ndarray) -> Iterator[Any]:
        """The decoded frames of `read`."""
        wanted = [int(n) for n in numbers]
        if any(b <= a for a, b in pairwise(wanted)):
            raise ValueError(f"frame indices must ascend, got {wanted[:6]} ...")
        for n in wanted:
            if not 0 <= n < self.count:
                raise SourceError(f"video {self.path} has frames 0 to {self.count - 1}, not {n}")
        with opened(self.path) as (container, stream):
            frames, at = self._from(container, stream, 0), -1
            for n in wanted:
                if self._key_between(at, n):
                    frames = self._from(container, stream, n)
                at, frame = next((f for f in frames if f[0] >= n), (-1, None))
                if frame is None or at != n or frame.is_corrupt:
                    raise SourceError(
                        f"frame {n} of video {self.path} cannot be decoded; the file is damaged there: leave that"
                        " frame out by frames.range, or its camera by views.sources"
                    )
                yield frame

    def _key_between(self, at: int, wanted: int) -> bool:
        return (
            wanted - at > _SEEK_GAP
            and self._index.pts is not None
            and any(at < k <= wanted for k, _ in self._index.keys)
        )

    def _from(self, container: Any, stream: Any, wanted: int) -> Iterator[tuple[int, Any]]:
        """Decoded frames with their index, from a keyframe from which on the wanted one comes out whole.

        That is the last keyframe, unless what is flagged so only begins a gradual refresh (H.264's recovery points):
        the decoder then gives no frame until the refresh is complete. The picture decoded first has nothing to refer
        to, and decoders lose some of those, so the refresh begun there is not relied on, but one that begins at a later
        recovery point and is complete by the wanted frame.
        """
        keys = [k for k in self._index.keys if k[0] <= wanted]
        if not keys or keys[-1][0] == 0:
            return self._decoded(container, stream)
        frames = self._decoded(container, stream, keys[-1])
        first = next((f for f in frames if f[0] >= keys[-1][0]), None)
        if first is None:
            return iter(())
        refresh = first[0] - keys[-1][0]
        if not refresh and first[1].pict_type not in _PREDICTED:
            return chain([first], frames)
        complete = [n for n, k in enumerate(keys) if k[0] + refresh <= wanted]
        return self._decoded(container, stream, keys[max(0, complete[-1] - 1) if complete else 0])

    def _decoded(self, container: Any, stream: Any, key: tuple[int, int] | None = None) -> Iterator[tuple[int, Any]]:
        """Frames with their index from a keyframe on, or from where the container is.

        Seeking goes to that keyframe's decode time: whether a container seeks by decode or by presentation time, it
        lands there or earlier, and frames of an open group that precede it in time are never asked for.
        """
        pts = self._index.pts
        if key is not None:
            container.seek(key[1], stream=stream, backward=True)
        known = {t: i for i, t in enumerate(pts)} if pts is not None else None
        for count, frame in enumerate(container.decode(stream)):
            if known is None:
                yield count, frame
            elif frame.pts in known:
                yield known[frame.pts], frame


@lru_cache(maxsize=512)
def _scan(path: str, size: int, mtime_ns: int) -> _Index:
    """Index of one state of a file; size and modification time are the cache's key."""
    held = contents(path)
    packets = [p for p in held.packets if not p[3]]
    if not packets:
        raise SourceError(f"video {path} holds no frames")
    with opened(path) as (container, stream):
        frame = next(container.decode(stream), None)
        if frame is None:
            raise SourceError(f"no frame of video {path} can be decoded")
        turns = _quarter_turns(frame, path)
        _to_rgb(frame, turns, Path(path))
    color = WideColor.of(int(frame.color_trc), int(frame.color_primaries))
    wide = round(frame.width * held.aspect)  # scaling to whole px leaves aspects beside 1, which mean nothing
    square = (frame.width if abs(wide - frame.width) <= 1 else wide, frame.height)
    shown = (frame.width, frame.height)
    shown, square = (shown[::-1], square[::-1]) if turns % 2 else (shown, square)
    times = sorted(p[0] for p in packets if p[0] is not None)
    exact = len(set(times)) == len(packets)
    place = {t: i for i, t in enumerate(times)}
    found = [(pts, dts) for pts, dts, key, _ in packets if key and pts is not None] if exact else []
    keys = sorted((place[pts], dts if dts is not None else pts) for pts, dts in found)
    seconds = np.array(times) * held.base if exact else np.zeros(0)
    periods, rate = _periods(seconds), held.rates[0] if held.rates else 0.0
    if len(seconds) > 1 and (periods is not None or not rate):
        passed = periods[-1] if periods else len(seconds) - 1
        rate = _rate(passed, float(seconds[-1] - seconds[0]), held.base, held.rates)
    return _Index(
        len(packets),
        shown,
        rate,
        turns,
        tuple(times) if exact else None,
        tuple(keys),
        seconds,
        periods,
        held.timecode,
        held.begins,
        square,
        bool(frame.interlaced_frame),
        color.name if color is not None else None,
        held.perhaps_cut,
    )


def _periods(seconds: np.ndarray) -> tuple[int, ...] | None:
    """What `VideoFile.periods` says of frames shown at these times: gaps that are longer than the usual one are whole
    multiples of it where frames were dropped, and something between where the rate varies."""
    gaps = np.diff(seconds)
    usual = gaps[gaps < LONG_GAP * np.median(gaps)] if len(gaps) else gaps
    if not len(usual) or len(usual) == len(gaps):
        return None
    apart = gaps / usual.mean()
    whole = np.rint(apart).astype(np.int64)
    if whole.min() < 1 or np.abs(apart - whole).max() > _OFF_MULTIPLE:
        return None
    return (0, *np.cumsum(whole).tolist())


def _rate(passed: int, span: float, unit: float, named: Sequence[float]) -> float:
    """Frames per second where so many pass in `span` seconds: the rate the file names, if its times, which are whole
    `unit`s of seconds, do not contradict it."""
    measured = passed / span
    return next((r for r in named if abs(r * span - passed) <= 2 * unit * r), measured)


def _quarter_turns(frame: Any, path: str) -> int:
    """Quarter turns counter-clockwise that show the frame upright, from its display matrix (ISO 14496-12, 6.2.2)."""
    data = next((bytes(s) for s in frame.side_data if s.type.name == "DISPLAYMATRIX"), None)
    if data is None:
        return 0
    m = np.frombuffer(data, dtype="<i4")[:5].astype(np.float64) / 65536
    a, b, c, d = m[0], m[1], m[3], m[4]
    for turns, matrix in enumerate(((1, 0, 0, 1), (0, -1, 1, 0), (-1, 0, 0, -1), (0, 1, -1, 0))):
        if np.allclose((a, b, c, d), matrix, atol=1e-3):
            return turns
    raise SourceError(
        f"video {path} asks to be shown with the display matrix ({a:g}, {b:g}, {c:g}, {d:g}); only quarter turns are"
        " read, so re-encode it upright"
    )


def _to_rgb(frame: Any, quarter_turns: int, path: Path) -> np.ndarray:
    """[h, w, 3] uint8 of a decoded frame, by swscale with the matrix and range spelled out."""
    from av.video.reformatter import ColorRange, Colorspace, Interpolation

    if int(frame.color_primaries) in _UNREAD_PRIMARIES:
        raise SourceError(
            f"video {path} has primaries {int(frame.color_primaries)} (ITU-T H.273), which are not read; convert it to"
            " BT.709 first"
        )
    wide = WideColor.of(int(frame.color_trc), int(frame.color_primaries))
    matrix, full = int(frame.colorspace), int(frame.color_range) == 2 or frame.format.name.startswith("yuvj")
    if frame.format.is_rgb:
        matrix, full = 1, True
    elif matrix == _UNSPECIFIED:
        matrix = (1 if frame.height >= 720 else 5) if wide is None or wide.primaries != BT2020 else 9
    elif matrix not in _MATRICES:
        raise SourceError(
            f"video {path} uses colour matrix {matrix} (ITU-T H.273), which is not read; convert it to BT.709 first"
        )
    rgb = frame.reformat(
        format="rgb24" if wide is None else "rgb48le",
        src_colorspace=Colorspace(_MATRICES[matrix]),
        dst_colorspace=Colorspace.ITU709,
        src_color_range=ColorRange.JPEG if full else ColorRange.MPEG,
        dst_color_range=ColorRange.JPEG,
        interpolation=Interpolation.BICUBIC
        | Interpolation.ACCURATE_RND
        | Interpolation.FULL_CHR_H_INT
        | Interpolation.BITEXACT,
        threads=1,
    ).to_ndarray()
    return np.ascontiguousarray(np.rot90(rgb if wide is None else wide.displayed(rgb), quarter_turns))
