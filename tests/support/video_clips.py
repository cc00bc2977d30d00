"""Small videos made for the tests, with any codec, container and tag."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np


def planes(y: np.ndarray, u: int = 128, v: int = 128) -> av.VideoFrame:
    """A yuv420p frame of given luma [h, w] and flat chroma."""
    h, w = y.shape
    packed = np.concatenate([y.reshape(-1), np.full(h * w // 4, u, np.uint8), np.full(h * w // 4, v, np.uint8)])
    return av.VideoFrame.from_ndarray(packed.reshape(h * 3 // 2, w).astype(np.uint8), format="yuv420p")


def write_clip(
    path: Path,
    frames: Sequence[av.VideoFrame],
    codec: str = "libx264",
    rate: int | Fraction = 30,
    tags: dict[str, int] | None = None,
    rotation: int = 0,
    timecode: str | None = None,
    times: Sequence[int] | None = None,
    unit: Fraction | None = None,
    aspect: Fraction | None = None,
    **options: Any,
) -> Path:
    """Encode frames as they are: no colour conversion happens. `times` are when they are shown, in units of `unit`
    seconds; by default frame after frame. `aspect` is a pixel's width over its height."""
    with av.open(str(path), "w") as container:
        if timecode is not None:
            container.metadata["timecode"] = timecode
        stream = container.add_stream(codec, rate=Fraction(rate), options={k: str(v) for k, v in options.items()})
        if unit is not None:
            stream.time_base = stream.codec_context.time_base = unit
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, frames[0].format.name
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        for name, value in (tags or {}).items():
            setattr(stream.codec_context, name, value)
        if rotation:
            stream.set_display_rotation(rotation)
        for i, frame in enumerate(frames):
            frame.pts, frame.time_base = times[i] if times else i, unit or 1 / Fraction(rate)
            for name, value in (tags or {}).items():
                setattr(frame, name, value)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def counting_clip(path: Path, count: int, size: tuple[int, int] = (32, 32), first: int = 0, **more: Any) -> Path:
    """Frame i is grey of luma 16 + 3 (i + first): `counted` reads i + first back."""
    greys = [planes(np.full(size[::-1], 16 + 3 * i, np.uint8)) for i in range(first, first + count)]
    return write_clip(path, greys, **more)


def counted(picture: np.ndarray) -> int:
    """Index of a frame of `counting_clip`."""
    return round((float(picture.mean()) * 219 / 255) / 3)


def copied(source: Path, target: Path, earlier: float = 0, first: int = 0, **options: str) -> Path:
    """A video's packets in another container, shown so many frames of 30 a second earlier, without those before the
    first keyframe from frame `first` on."""
    with av.open(str(source)) as i, av.open(str(target), "w", options=options) as o:
        stream = i.streams.video[0]
        assert stream.time_base is not None
        out = o.add_stream_from_template(stream)
        shift, begun = round(earlier / 30 / stream.time_base), not first
        for packet in i.demux(stream):
            if packet.pts is None or packet.dts is None:
                continue
            begun = begun or (packet.is_keyframe and packet.pts * stream.time_base >= Fraction(first, 30))
            if begun:
                packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, out
                o.mux(packet)
    return target
