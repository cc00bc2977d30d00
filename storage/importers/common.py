"""What every importer needs: options, files by frame number, streams, and the sentences about them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from posegaussian.storage.formats.joint_files import frame_number
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.splits import said_of, splits_of
from posegaussian.storage.readers import images
from posegaussian.storage.readers.video import VIDEO_SUFFIXES

_CLUTTER = ("@eaDir", "__MACOSX")
"""Folders that a NAS and macOS put beside a capture's own."""


def _listed(value: Any) -> Any:
    """`cam01,cam02` as the list it stands for."""
    if isinstance(value, str):
        return [part.strip() for part in value.split(",") if part.strip()]
    return (
        [str(v) if isinstance(v, int) else v for v in value]
        if isinstance(value, list)
        else [str(value)]
        if isinstance(value, int)
        else value
    )


Names = Annotated[tuple[str, ...], BeforeValidator(_listed)]
"""Names of cameras, given as a list or with commas."""


class ImportOptions(BaseModel):
    """Choices that every layout has."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    cameras: Names | None = Field(None, description="Names of the cameras to import; all by default.")
    held_out: Names | None = Field(
        None, description="Names of the cameras that only metrics may look at; by default those that the layout marks."
    )
    crop: dict[str, Crop] = Field(
        {},
        description=(
            "Per camera, captured pixel to calibrated pixel, where their sizes differ (frames.crop); by default what"
            " the pictures show."
        ),
    )
    frame_rate: float | None = Field(
        None, gt=0, description="Frames per second; by default what the videos or the layout say."
    )
    timecode: Literal["auto", "ignore"] = Field(
        "auto",
        description=(
            "Whether videos are brought into step by the timecode that all carry or, without any, by when their files"
            " show the first frame; or taken to begin together."
        ),
    )
    joint_set: str | None = Field(
        None, description="Joint set of the 2D joints; by default judged by the number of joints and the folder's name."
    )

    @property
    def crops(self) -> dict[str, Crop]:
        """The crops of the cameras that are imported."""
        return {n: c for n, c in self.crop.items() if self.cameras is None or n in self.cameras}

    def pick(self, found: Sequence[str]) -> tuple[str, ...]:
        """The cameras to import out of those found, in the order asked for.
        Raises SourceError for one that is not there."""
        for name in self.cameras or ():
            if name not in found:
                raise SourceError(f"option cameras: no pictures of a camera named {name}; there are {', '.join(found)}")
        return tuple(found) if self.cameras is None else self.cameras


def natural(path: Path | str) -> list[tuple[int, int | str]]:
    """Sort key: cam2 before cam10. A circled or superscript digit is no digit of a number."""
    return [(0, int(p)) if p.isdecimal() else (1, p) for p in re.split(r"(\d+)", str(path)) if p]


def folder(path: Path) -> Path:
    """The folder itself, or SourceError when it is missing, no folder or empty."""
    if not path.is_dir():
        raise SourceError(
            f"{path} is a file; give the capture's folder" if path.exists() else f"no such folder: {path}"
        )
    if not any(path.iterdir()):
        raise SourceError(f"folder {path} is empty")
    return path


def chosen(base: Path, option: str | None, what: str) -> Path | None:
    """An optional path of the options, relative to the capture's folder. Raises SourceError when it does not exist."""
    if option is None:
        return None
    path = base / option
    if not path.exists():
        raise SourceError(f"option {what}: no such file or folder: {path}")
    return path


def shown(base: Path, paths: Iterable[Path]) -> str:
    """Paths for a sentence, relative to the capture's folder where they lie in it."""
    return ", ".join(str(p.relative_to(base) if p.is_relative_to(base) else p) for p in paths)


def is_clutter(name: str) -> bool:
    """Whether a file or folder of that name is hidden, as AppleDouble's `._cam1.mp4`, or none of the capture's own."""
    return name.startswith(".") or name in _CLUTTER


def entries(path: Path) -> list[Path]:
    """What a capture has in a folder, in natural order; nothing when it does not exist."""
    found = path.iterdir() if path.is_dir() else ()
    return sorted((p for p in found if not is_clutter(p.name)), key=lambda p: natural(p.name))


def all_below(base: Path) -> list[Path]:
    """What a capture has in a folder and its folders, in the order of names."""
    return sorted(p for p in base.rglob("*") if not any(map(is_clutter, p.relative_to(base).parts)))


def subfolders(path: Path) -> list[Path]:
    """Folders in a folder in natural order; none when it does not exist."""
    return [p for p in entries(path) if p.is_dir()]


def has_pictures(base: Path) -> bool:
    """Whether a folder has `images/NAME/` with a picture in it."""
    return any(
        p.suffix.lower() in images.PICTURE_SUFFIXES for camera in subfolders(base / "images") for p in entries(camera)
    )


def videos_in(path: Path) -> dict[str, Path]:
    """{stem: video} of one folder in natural order. Raises SourceError for two videos of one name."""
    out: dict[str, Path] = {}
    for p in (p for p in entries(path) if p.suffix.lower() in VIDEO_SUFFIXES):
        if p.stem in out:
            raise SourceError(
                f"two videos would be camera {p.stem}: {out[p.stem].name} and {p.name}; take one out of {path}"
            )
        out[p.stem] = p
    return out


def numbered(path: Path, suffixes: Iterable[str]) -> dict[int, Path]:
    """{frame number: file} of the files of one folder with one of the endings.
    Raises SourceError for a number twice or none."""
    out: dict[int, Path] = {}
    for p in sorted(path.iterdir()) if path.is_dir() else []:
        if p.suffix.lower() not in suffixes or is_clutter(p.name):
            continue
        n = frame_number(p)
        if n is None:
            raise SourceError(f"{p} holds no frame number in its name; rename it, for example to 000000{p.suffix}")
        if n in out:
            raise SourceError(f"two files are frame {n} in {path}: {out[n].name} and {p.name}")
        out[n] = p
    return dict(sorted(out.items()))


def file_stream(kind: str, files: Mapping[int, Path], size: tuple[int, int] = (0, 0), **options: object) -> Stream:
    """A stream of one file a frame."""
    return Stream(kind, tuple(SourceFile.of(p) for p in files.values()), tuple(files), size, options)  # type: ignore[arg-type]


def image_stream(camera: str, files: Mapping[int, Path]) -> Stream:
    """Pictures of one view, one file a frame. Raises SourceError when one has another size than the first."""
    first = next(iter(files.values()))
    size = images.picture_size(first)
    for p in files.values():
        if (other := images.picture_size(p)) != size:
            raise SourceError(
                f"camera {camera}: {p} is {other[0]}x{other[1]} px, {first.name} is {size[0]}x{size[1]} px;"
                " one camera has one size"
            )
    return file_stream("images", files, size)


def whole_scale(size: Sequence[int], other: Sequence[int]) -> float | None:
    """Px of the size `other` (width, height) in one of `size`, of one picture that was scaled; None where the shapes
    differ by more than a pixel of either."""
    (w, h), (cw, ch) = other, size
    scale = w / cw if cw >= ch else h / ch
    if max(abs(scale * cw - w), abs(scale * ch - h)) > max(1.0, scale):
        return None
    return float(scale)


def size_of(what: str, camera: str, files: Mapping[int, Path], picture: tuple[int, int]) -> tuple[int, int]:
    """(width, height) px of all files of a camera, each `what`, that show the whole of its pictures of (width, height)
    px and may be smaller or larger. Raises SourceError for another shape, and for files of several sizes."""
    first = next(iter(files.values()))
    size = images.picture_size(first)
    if whole_scale(size, picture) is None:
        raise SourceError(
            f"camera {camera}, frame {next(iter(files))}: {what} {first} is {size[0]}x{size[1]} px, its picture is"
            f" {picture[0]}x{picture[1]} px, which is another shape; a {what} may be smaller or larger, but must show"
            f" the whole picture: crop or pad the {what}s to the pictures' shape"
        )
    for n, p in files.items():
        if (other := images.picture_size(p)) != size:
            raise SourceError(
                f"camera {camera}, frame {n}: {what} {p} is {other[0]}x{other[1]} px, the first one is"
                f" {size[0]}x{size[1]} px; one camera has one size"
            )
    return size


def with_splits(capture: Capture, order: Sequence[str], subject: str) -> Capture:
    """The capture with the protocols of its data set and a sentence on each; `order` and `subject` as in
    `splits_of`."""
    splits = splits_of(capture.layout, order, capture.rig.names, subject)
    return replace(capture, splits=splits, notes=(*capture.notes, *said_of(splits, capture.rig.names)))


def gap_notes(
    names: Sequence[str], streams: Sequence[Stream | None], expected: Sequence[Sequence[int] | np.ndarray], what: str
) -> list[str]:
    """A sentence for every camera whose stream lacks some of the frames it is expected to have."""
    notes = []
    for name, stream, wanted in zip(names, streams, expected, strict=True):
        if stream is not None and (lacking := np.setdiff1d(wanted, stream.numbers)).size:
            notes.append(f"camera {name} lacks {what} of {lacking.size} frames ({ranges(lacking)})")
    return notes


def picture_gaps(names: Sequence[str], streams: Sequence[Stream]) -> list[str]:
    """Sentences about the cameras that lack frames which another one has, and those that share none with any."""
    numbers = np.concatenate([np.asarray(s.numbers, dtype=np.int64) for s in streams])
    everything, times = np.unique(numbers, return_counts=True)
    alone = [
        f"camera {name} shares no frame with any other ({ranges(np.array(s.numbers))}), so that nothing is made of its"
        " pictures and theirs together: give pictures of one moment one number, and import again"
        for name, s in zip(names, streams, strict=True)
        if len(streams) > 1 and (times[np.isin(everything, s.numbers)] == 1).all()
    ]
    return [*alone, *gap_notes(names, streams, [everything] * len(streams), "pictures")]


def ranges(values: np.ndarray, most: int = 4) -> str:
    """`0-3, 7, 9-12` of ascending integers, cut after `most` parts."""
    runs = np.split(values, np.flatnonzero(np.diff(values) > 1) + 1)
    parts = [str(r[0]) if len(r) == 1 else f"{r[0]}-{r[-1]}" for r in runs]
    return ", ".join(parts[:most]) + (", ..." if len(parts) > most else "")
