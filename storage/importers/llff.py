"""Rigs in LLFF's layout, which DyNeRF (Neural 3D Video) and others share: `poses_bounds.npy` and videos or pictures.

A row a camera: a 3x5 matrix of the camera's down, right and backward axes in the world, its place, and (height, width,
focal length), then the nearest and farthest depth. The principal point is the middle, there is no distortion, and the
unit is whatever COLMAP's was. Rows go with the cameras' names sorted as texts: cam10 comes before cam2. Format:
https://github.com/Fyusion/LLFF, llff/poses/pose_utils.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from posegaussian.storage.formats.plain_npy import read_numbers
from posegaussian.storage.importers.cameras import DISTORTION, build_rig
from posegaussian.storage.importers.common import (
    entries,
    folder,
    has_pictures,
    natural,
    numbered,
    subfolders,
    videos_in,
)
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.evidence import UnitOptions, check_direction, metres
from posegaussian.storage.importers.masks import mask_streams
from posegaussian.storage.importers.posed_images import PosedImage, sorted_by_camera, still_camera
from posegaussian.storage.importers.posed_pictures import Files, picture_streams
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.images import PICTURE_SUFFIXES

POSES = "poses_bounds.npy"
COLUMNS = 17
DIRECTION = "camera to world"


class LlffOptions(UnitOptions):
    """What to take where several fit."""

    pictures: Literal["auto", "images", "videos"] = Field(
        "auto", description="What is filmed; auto takes videos where there are any."
    )
    moment: bool | None = Field(
        None, description="Pictures of one folder are all of one instant; by default as the poses tell."
    )


def find(source: Path, options: LlffOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    rows = _rows(base / POSES)
    files, notes = _files(base, options)
    if len(files) != len(rows):
        raise CalibrationError(
            f"{base / POSES} has {len(rows)} rows, and there are {len(files)} cameras ({', '.join(list(files)[:6])});"
            " rows go with names sorted as texts, so add what is missing, or take out what has no pose"
        )
    posed = [_posed(name, row) for name, row in zip(files, rows, strict=True)]
    single = all(not isinstance(f, Path) and len(f) == 1 for f in files.values())
    sorted_by_camera(posed, options.moment if single else True)  # refuses a walk, and what is no pose
    names = options.pick(tuple(files))
    cameras = {i.name: still_camera(i.name, {0: i}, 1.0) for i in posed}
    rotations = np.array([c.rotation for c in cameras.values()])
    centres = np.array([i.centre for i in posed])
    scale, unit = metres(options, tuple(files), centres, POSES)
    facing = check_direction(tuple(files), rotations, centres, DIRECTION)
    pictures, rate, more = picture_streams({n: files[n] for n in names}, options)
    rig = build_rig(
        [still_camera(n, {0: i}, scale) for n in names for i in posed if i.name == n],
        [s.size for s in pictures],
        half=True,
    )
    masks, mask_notes = mask_streams(names, [base / "masks" / n for n in names], pictures)
    return Capture(
        "llff",
        rig,
        rate,
        tuple(pictures),
        masks=masks,
        notes=(
            f"cameras of {POSES}: {len(rows)} rows, in the order of names as texts, {', '.join(list(files)[:3])}, ...",
            *notes,
            unit,
            *facing,
            *more,
            *mask_notes,
        ),
    )


def _rows(path: Path) -> np.ndarray:
    """[N, 17] of the file. Raises CalibrationError."""
    try:
        found = read_numbers(path, "poses")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    if found.ndim != 2 or found.shape[1] != COLUMNS or not len(found):
        raise CalibrationError(f"{path} holds numbers of shape {found.shape}; [cameras, {COLUMNS}] is expected")
    if not np.isfinite(found).all():
        row = int(np.argwhere(~np.isfinite(found))[0, 0])
        raise CalibrationError(f"{path}: row {row} holds a number that is not finite")
    return found


def _posed(name: str, row: np.ndarray) -> PosedImage:
    down, right, backward, centre, (height, width, focal) = row[:15].reshape(3, 5).T
    if not (width == int(width) and height == int(height)):
        raise CalibrationError(f"camera {name}: the size {width:g} x {height:g} px in {POSES} must be whole numbers")
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    rotation = np.stack([right, down, -backward])
    return PosedImage(name, intrinsics, np.zeros(DISTORTION), rotation, centre, (int(width), int(height)))


def _files(base: Path, options: LlffOptions) -> tuple[dict[str, Files], list[str]]:
    """({camera: video or pictures} sorted as texts, notes)."""
    videos = (videos_in(base) or videos_in(base / "videos")) if options.pictures != "images" else {}
    out: dict[str, Files] = dict(videos)
    if not out and options.pictures != "videos":
        out = {f.name: n for f in subfolders(base / "images") if (n := numbered(f, PICTURE_SUFFIXES))}
    if not out and options.pictures != "videos" and (base / "images").is_dir():
        for p in entries(base / "images"):
            if p.suffix.lower() in PICTURE_SUFFIXES:
                if p.stem in out:
                    raise SourceError(f"two pictures would be camera {p.stem} in {base / 'images'}; take one out")
                out[p.stem] = {0: p}
    if not out:
        raise SourceError(f"no CAM.mp4, videos/CAM.mp4, images/CAM/000000.png or images/CAM.png in {base}")
    names = sorted(out)
    notes = []
    if names != sorted(names, key=natural):
        notes.append(f"names sorted as texts have {names[1]} behind {names[0]}, so rows go with them in that order")
    return {n: out[n] for n in names}, notes


def _has_files(base: Path) -> bool:
    return has_pictures(base) or or_broken(
        lambda: videos_in(base) or videos_in(base / "videos") or entries(base / "images")
    )


IMPORTER = Importer(
    "llff",
    "poses_bounds.npy and videos or pictures of the cameras, as LLFF and DyNeRF have them.",
    LlffOptions,
    find,
    (
        Trait(POSES, lambda base: (base / POSES).is_file()),
        Trait("CAM.mp4, or pictures in images", _has_files, filmed=True),
    ),
    masked=True,
)
