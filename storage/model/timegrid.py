"""Time as integers: which source frames a sequence holds, and how it is cut into partitions with halos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posegaussian.storage.model.cameras import must_be_cameras


def parse_range(text: str) -> tuple[int | None, int | None, int]:
    """`"start:stop:stride"` -> (start, stop, stride); empty parts are None, None, 1.

    Raises ValueError for what is not three integers, for a negative bound and for a stride below 1.
    """
    parts = text.split(":")
    if not 2 <= len(parts) <= 3:
        raise ValueError(f"range {text!r} is not start:stop:stride, for example 0:96:2")
    try:
        start, stop, stride = [int(p) if p.strip() else None for p in [*parts, ""][:3]]
    except ValueError:
        raise ValueError(f"range {text!r} is not made of integers, for example 0:96:2") from None
    stride = 1 if stride is None else stride
    if stride < 1 or (start or 0) < 0 or (stop or 0) < 0:
        raise ValueError(f"range {text!r}: start and stop must not be negative and the stride at least 1")
    return start, stop, stride


def select(numbers: Sequence[int] | np.ndarray, text: str) -> np.ndarray:
    """The source frame numbers, ascending, that lie on the range: n >= start, n < stop, (n - start) % stride == 0.

    `start` defaults to the first number, so that pictures numbered from 1 with stride 2 give 1, 3, 5, ...
    """
    numbers = np.asarray(numbers, dtype=np.int64)
    start, stop, stride = parse_range(text)
    if numbers.size == 0:
        return numbers
    first = int(numbers[0]) if start is None else start
    last = int(numbers[-1]) + 1 if stop is None else stop
    return numbers[(numbers >= first) & (numbers < last) & ((numbers - first) % stride == 0)]


def late_frames(names: Sequence[str], offsets: Mapping[str, float], sequence: str) -> tuple[int, ...]:
    """[V] whole frames by which each camera is late, from `frames.time_offset`; `sequence` is named in the errors.
    Raises ConfigError for cameras that there are none of."""
    must_be_cameras("frames.time_offset", offsets, names, sequence)
    return tuple(round(offsets.get(n, 0.0)) for n in names)


@dataclass(frozen=True)
class TimeGrid:
    """A sequence of `frames` frames cut into partitions of `length` frames; the last may be shorter."""

    frames: int
    """Frames of the sequence."""
    length: int
    """Frames of a partition, fixed at import."""

    def __post_init__(self) -> None:
        if self.length < 1:
            raise ValueError(f"partition length must be at least 1 frame, got {self.length}")

    @property
    def partitions(self) -> range:
        """Partition numbers."""
        return range(-(-self.frames // self.length))

    def bounds(self, partition: int) -> range:
        """Frame indices of one partition."""
        return range(partition * self.length, min((partition + 1) * self.length, self.frames))

    def span(self, partition: int, halo: tuple[int, int]) -> range:
        """Frame indices of a partition and its halo, clipped to the sequence."""
        own = self.bounds(partition)
        return range(max(0, own.start - halo[0]), min(self.frames, own.stop + halo[1]))

    def touched(self, span: range) -> range:
        """Partitions that hold the frames of a span."""
        return range(span.start // self.length, -(-span.stop // self.length)) if len(span) else range(0)
