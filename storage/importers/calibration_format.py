"""What a calibration format declares, and what it makes of a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from posegaussian.storage.importers.cameras import RawCamera
from posegaussian.storage.model.errors import CalibrationError

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
    unit_from: str = "as the file says"
    """How the unit is known, for sentences."""


@dataclass(frozen=True)
class CalibrationFormat:
    """One format."""

    name: str
    """For sentences."""
    fits: Callable[[Path], bool]
    """Whether a file is of it, by its content; never raises."""
    read: Callable[[Path], Calibration]
    """Raises CalibrationError, naming file and camera."""
    alone: bool = False
    """Whether a file may hold one camera, so that several files together are a rig."""
    left: Callable[[Path], bool] = lambda _: False
    """Whether `import auto` leaves a file of it to another layout, which reads more of its folder; never raises."""


def fixed(camera: RawCamera) -> Sized:
    """A camera whose intrinsics are the same for pictures of any size."""
    return lambda _: camera


def read_together(paths: Sequence[Path], form: CalibrationFormat) -> Calibration:
    """The cameras of all files of one format. Raises CalibrationError for a camera that two files hold."""
    read = [form.read(p) for p in paths]
    cameras: dict[str, Sized] = {}
    for path, calibration in zip(paths, read, strict=True):
        for name, camera in calibration.cameras.items():
            if name in cameras:
                raise CalibrationError(
                    f"calibration {path}: camera {name} is in another file of {path.parent}, too; name the file that is"
                    " meant with --option calibration=FILE"
                )
            cameras[name] = camera
    return replace(read[0], cameras=cameras)


def begins(path: Path, suffixes: tuple[str, ...], part: str, most: int = 4096) -> bool:
    """Whether a file of one of the endings holds a text within its first bytes."""
    if path.suffix.lower() not in suffixes or not path.is_file():
        return False
    try:
        with path.open("rb") as f:
            return part.encode() in f.read(most)
    except OSError:
        return False
