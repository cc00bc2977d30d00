"""What a layout of exported captures is, and the pictures, which lie alike in all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posegaussian.storage.exporters.frames import refuse_strangers
from posegaussian.storage.files.names import check_camera_names
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.images import write_png

IMAGES, MASKS = "images", "masks"
"""Folders of pictures and masks: `images/CAM/000012.png`."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Cameras without distortion, what they filmed, and a cloud of the first instant."""

    rig: Rig
    """Our pixel centres, metres; distortion is zero."""
    frame_rate: float
    """1/s of the source frame numbers."""
    numbers: tuple[tuple[int, ...], ...]
    """[V] source frame numbers of each camera's pictures, ascending."""
    masks: bool
    """Whether every picture has a mask."""
    held_out: tuple[str, ...]
    """Cameras that only metrics look at."""
    points: np.ndarray
    """[N, 3] float64, metres; none for a layout without a cloud."""
    colors: np.ndarray
    """[N, 3] uint8 sRGB."""

    @property
    def instants(self) -> list[int]:
        """All source frame numbers."""
        return sorted({n for own in self.numbers for n in own})

    def images(self) -> Iterable[tuple[int, int, str]]:
        """(view, source frame number, `CAM/000012.png`) of all pictures, camera by camera."""
        return ((v, n, picture_name(self.rig.names[v], n)) for v, own in enumerate(self.numbers) for n in own)


def any_cameras(rig: Rig) -> None:
    """The check of a layout that holds every camera."""


@dataclass(frozen=True)
class Layout:
    """One layout that captures leave in."""

    name: str
    """As in `export --to NAME`."""
    summary: str
    """One sentence for the help."""
    write: Callable[[Path, Recording], None]
    """Writes cameras and cloud beside the pictures. Raises UserError for what the layout cannot hold."""
    cloud: bool = False
    """Whether it holds a cloud of points."""
    still: bool = False
    """Whether most tools that read it take a scene to stand still."""
    check: Callable[[Rig], None] = any_cameras
    """Raises UserError for cameras that the layout cannot hold: asked before a run, and again when it is written."""


def picture_name(camera: str, number: int) -> str:
    """`CAM/000012.png`."""
    return f"{camera}/{number:06d}.png"


def check_folder(folder: Path, rig: Rig, numbers: Iterable[int]) -> None:
    """Raise UserError for a folder with pictures that an export would leave beside its own."""
    check_camera_names(rig.names)
    for part in (IMAGES, MASKS):
        refuse_strangers(folder / part, rig.names, list(numbers))


def check_undistorted(recording: Recording) -> None:
    """Raise UserError for cameras with distortion: exported pictures have none."""
    if recording.rig.distortion.any():
        raise UserError("pictures with distortion are not exported; they are undistorted when frames are made")


def write_pictures(folder: Path, rig: Rig, pictures: Iterable[tuple[int, int, np.ndarray, np.ndarray | None]]) -> int:
    """Write `images/CAM/000012.png` and `masks/CAM/000012.png`; returns the number of pictures.

    A picture is (view, source frame number, [h, w, 3] uint8 sRGB, [h, w] uint8 mask or None). Raises NotWritten.
    """
    count = 0
    for view, number, color, mask in pictures:
        name = picture_name(rig.names[view], number)
        write_png(folder / IMAGES / name, color)
        if mask is not None:
            write_png(folder / MASKS / name, mask)
        count += 1
    return count
