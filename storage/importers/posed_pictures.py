"""What the cameras of posed images filmed: the images' folders, or videos of the cameras' names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import Field

from posegaussian.storage.importers.camera_folders import videos_of
from posegaussian.storage.importers.common import ImportOptions, image_stream, numbered
from posegaussian.storage.importers.evidence import UnitOptions
from posegaussian.storage.importers.films import video_streams
from posegaussian.storage.importers.posed_images import Cameras, PosedImage
from posegaussian.storage.model.capture import Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.images import PICTURE_SUFFIXES

DEFAULT_RATE = 30.0
"""Frames per second of folders of images, which do not say theirs."""

Files = dict[int, Path] | Path
"""Pictures by source frame number, or a video."""


class PosedOptions(UnitOptions):
    """What to take of posed images where several fit."""

    pictures: Literal["auto", "images", "videos"] = Field(
        "auto", description="What is filmed; auto takes images, and videos where there is one image a camera."
    )
    moment: bool | None = Field(
        None, description="Every image is another camera's, all of one instant; by default as names and poses tell."
    )


def picture_files(
    base: Path, root: Path, cameras: Cameras, kind: str, otherwise: str
) -> tuple[dict[str, Files], list[str]]:
    """({camera: its pictures or video}, notes) of the cameras that have any; names of images are relative to `root`,
    `kind` is auto, images or videos. Raises SourceError where there are none or not of all, which ends with what to do
    `otherwise`."""
    videos = videos_of(base / "videos", cameras.images.__contains__) if kind != "images" else {}
    single = all(len(g) == 1 for g in cameras.images.values())
    out: dict[str, Files] = {}
    more = 0
    for name, group in cameras.images.items():
        placed = {n: root / i.name for n, i in group.items() if (root / i.name).is_file()}
        own = _own_folder(root, cameras, name, group)
        every = numbered(own, PICTURE_SUFFIXES) if own is not None else {}
        if name in videos and (kind == "videos" or (single and len(every) < 2)):
            out[name] = videos[name]
        elif kind != "videos" and (every or placed):
            out[name] = every or placed
            more += len(every) - len(group) if every else 0
            lacking = [i.name for i in group.values() if not (root / i.name).is_file()]
            if lacking and not every:
                raise SourceError(f"image {lacking[0]} of the model is not in {root}; {otherwise}")
    if not out:
        first = next(iter(next(iter(cameras.images.values())).values()))
        raise SourceError(
            f"no pictures of the model's images, such as {first.name},"
            f" in {root}, and no videos/NAME.mp4 of cameras {', '.join(list(cameras.images)[:4])}; {otherwise}"
        )
    notes = [f"{more} pictures beside the model's images are taken with their camera's pose"] if more > 0 else []
    kinds = {isinstance(f, Path) for f in out.values()}
    if len(kinds) > 1:
        without = next(n for n, f in out.items() if not isinstance(f, Path))
        raise SourceError(f"some cameras have videos and camera {without} has none; add it, or set the option pictures")
    return out, notes


def _own_folder(root: Path, cameras: Cameras, name: str, group: Mapping[int, PosedImage]) -> Path | None:
    """The folder that holds a camera's pictures alone, those too that the model has not."""
    if any(i.number is not None for i in group.values()):
        return None  # numbers are the file's, not those of the names
    if cameras.by == "folder":
        return (root / next(iter(group.values())).name).parent
    return root / name if cameras.by == "moment" and (root / name).is_dir() else None


def picture_streams(files: Mapping[str, Files], options: ImportOptions) -> tuple[list[Stream], float, list[str]]:
    """(streams, frames per second, notes) of cameras' pictures or videos. Raises SourceError."""
    videos = {n: f for n, f in files.items() if isinstance(f, Path)}
    if videos:
        return video_streams(videos, options.frame_rate)
    streams = [image_stream(n, f) for n, f in files.items() if not isinstance(f, Path)]
    rate = options.frame_rate or DEFAULT_RATE
    assumed = "" if options.frame_rate else " (assumed; set frame_rate)"
    return (
        streams,
        rate,
        [f"pictures: images at {rate:g} frames/s{assumed}"] if any(len(s.numbers) > 1 for s in streams) else [],
    )
