"""What a calibration format declares, and what it makes of a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from posegaussian.storage.importers.cameras import RawCamera

Sized = Callable[[tuple[int, int]], RawCamera]
"""A camera for pictures of a size (width, height) px: some formats count in parts of it. Raises CalibrationError."""


@dataclass(frozen=True)
class Calibration:
    """The cameras of a file, world to camera, OpenCV axes."""

    cameras: Mapping[str, Sized]
    """By name; translations in the file's unit."""
    direction: str
    """Direction of the poses in the file, for sentences."""
    half: bool
    """Whether principal points count from the first pixel's corner."""
    metres: float | None
    """Metres in a unit; None where the format has no unit."""


@dataclass(frozen=True)
class CalibrationFormat:
    """One format."""

    name: str
    """For sentences."""
    fits: Callable[[Path], bool]
    """Whether a file is of it, by its content; never raises."""
    read: Callable[[Path], Calibration]
    """Raises CalibrationError, naming file and camera."""


def begins(path: Path, suffixes: tuple[str, ...], part: str, most: int = 4096) -> bool:
    """Whether a file of one of the endings holds a text within its first bytes."""
    if path.suffix.lower() not in suffixes or not path.is_file():
        return False
    try:
        with path.open("rb") as f:
            return part.encode() in f.read(most)
    except OSError:
        return False
