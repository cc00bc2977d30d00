"""Settings of a first look: few frames, small pictures, the whole way in minutes instead of hours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from posegaussian.storage.model.capture import Capture

FRAMES = 24
"""That show enough of a motion."""
SIZE = 512
"""px of the longest side at which a person is told."""
ALL = "::"
"""`frames.range` where nothing is chosen."""


def few_frames(numbers: Sequence[int]) -> str | None:
    """`frames.range` of the first FRAMES of some source frame numbers; None where there are no more."""
    return f"{int(numbers[0])}:{int(numbers[FRAMES - 1]) + 1}" if len(numbers) > FRAMES else None


def first_look(capture: Capture, frames: Any) -> list[str]:
    """Words of a command that make a capture small, none where it is; `frames` are that stage's settings: what the
    user set of them stays."""
    few = few_frames(capture.numbers.tolist()) if frames.range == ALL else None
    large = frames.size is None and int(capture.rig.size.max()) > SIZE
    chosen = [*([f"frames.range={few}"] if few else []), *([f"frames.size={SIZE}"] if large else [])]
    return [word for setting in chosen for word in ("--set", setting)]
