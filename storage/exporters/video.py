"""Video out: H.264 in mp4 that every browser plays."""

from __future__ import annotations

import errno
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.files.write import ask_why, whole_file
from posegaussian.storage.model.errors import UserError

_BT709 = 1
_LIMITED = 1
_QUALITY = "16"
"""x264 constant rate factor; 16 is visually lossless."""
SLOWEST, FASTEST = 1 / 3600, 1e6
"""Frames a second that an mp4 holds and players read."""
_FAST = 1000
"""Frames a second, and ticks of an mp4's own clock: of what lies between two ticks nothing is shown."""


def write_video(path: str | Path, frames: Iterable[np.ndarray], rate: float) -> int:
    """Write [h, w, 3] uint8 sRGB frames as H.264, yuv420p, BT.709 limited range (converted and tagged), and count them.

    Odd sizes are padded to even ones by repeating the last row or column. The file appears under its name only when it
    is whole. Raises UserError for a rate beyond `SLOWEST` and `FASTEST`, when there are no frames or the path does not
    end in .mp4, ValueError when a frame has another size than the first, NotWritten when the disk does not take it.
    """
    check_rate(path, rate)
    path = Path(path)
    if path.suffix.lower() != ".mp4":
        raise UserError(f"video {path}: videos are written as .mp4, not {path.suffix or 'without an ending'}")
    with whole_file(path) as partial:
        count = _encode(partial, frames, rate)
        if count == 0:
            raise UserError(f"video {path}: there are no frames to write")
        if _packets(partial) != count:
            ask_why(partial, 2 * partial.stat().st_size, "not all frames arrived in the file")
    return count


def check_rate(path: str | Path, rate: float) -> None:
    """Raise UserError for frames a second beyond `SLOWEST` and `FASTEST`."""
    if not SLOWEST <= rate <= FASTEST:
        raise UserError(
            f"video {path}: {rate:g} frames a second; a video has 1 in {1 / SLOWEST:.0f} seconds to {FASTEST:.0f} a"
            " second: correct the capture's frame rate, or write pictures (--frames)"
        )


def _encode(part: Path, frames: Iterable[np.ndarray], rate: float) -> int:
    import av
    import av.error
    import av.logging

    av.logging.set_level(av.logging.PANIC)
    iterator = iter(frames)
    first = next(iterator, None)
    if first is None:
        return 0
    count = 0
    try:
        options = {"movflags": "+faststart"} | ({"movie_timescale": f"{FASTEST:.0f}"} if rate > _FAST else {})
        with av.open(str(part), "w", format="mp4", options=options) as container:
            stream = _stream(container, first.shape, rate)
            for count, picture in enumerate(_chain(first, iterator), start=1):
                if picture.shape != first.shape or picture.dtype != np.uint8:
                    raise ValueError(
                        f"frame {count - 1} is {picture.dtype} {picture.shape}, the first one is uint8 {first.shape}"
                    )
                frame = _frame(picture)
                frame.pts, frame.time_base = count - 1, 1 / stream.codec_context.framerate
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
    except av.error.FFmpegError as e:  # of numbers that Python has no class for, and of FFmpeg's own, it is no OSError
        raise OSError(e.errno if e.errno in errno.errorcode else errno.EIO, e.strerror or str(e)) from e
    return count


def _packets(file: Path) -> int:
    """Encoded frames that a file holds."""
    import av
    import av.error

    try:
        with av.open(str(file)) as container:
            return sum(packet.size > 0 for packet in container.demux(video=0))
    except (av.error.FFmpegError, OSError):
        return 0


def _chain(first: np.ndarray, rest: Iterable[np.ndarray]) -> Iterable[np.ndarray]:
    yield first
    yield from rest


def _stream(container: Any, shape: tuple[int, ...], rate: float) -> Any:
    exact = Fraction(rate).limit_denominator(1001) if rate >= 1 else 1 / Fraction(1 / rate).limit_denominator(1001)
    stream = container.add_stream("libx264", rate=exact, options={"crf": _QUALITY, "preset": "medium"})
    stream.width, stream.height, stream.pix_fmt = shape[1] + shape[1] % 2, shape[0] + shape[0] % 2, "yuv420p"
    context = stream.codec_context
    context.color_primaries = context.color_trc = context.colorspace = _BT709
    context.color_range = _LIMITED
    context.thread_count = 1
    return stream


def _frame(picture: np.ndarray) -> Any:
    """The yuv420p frame of a picture, by swscale with the BT.709 matrix."""
    import av
    from av.video.reformatter import ColorRange, Colorspace, Interpolation

    height, width = picture.shape[:2]
    even = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24").reformat(
        format="yuv420p",
        src_colorspace=Colorspace.ITU709,
        dst_colorspace=Colorspace.ITU709,
        src_color_range=ColorRange.JPEG,
        dst_color_range=ColorRange.MPEG,
        interpolation=Interpolation.BICUBIC
        | Interpolation.ACCURATE_RND
        | Interpolation.FULL_CHR_H_INP
        | Interpolation.BITEXACT,
        threads=1,
    )
    frame.colorspace, frame.color_range = _BT709, _LIMITED
    frame.color_primaries = frame.color_trc = _BT709
    return frame
