"""Videos or folders of pictures of one's own, with a calibration that another program wrote.

`NAME.mp4`, `videos/NAME.mp4`, the one video in `videos/NAME/` or `images/NAME/000000.jpg` and a calibration, recognised
by its content: the formats of `calibration_formats.py`. A camera's name in it is that of its video or folder.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
from pydantic import Field

from posegaussian.storage.importers.calibration_format import CalibrationFormat, read_together
from posegaussian.storage.importers.calibration_formats import FORMATS
from posegaussian.storage.importers.caliscope import unread_times
from posegaussian.storage.importers.camera_folders import has_camera_folders, videos_of
from posegaussian.storage.importers.cameras import build_rig, check_principal_point, raw_centre
from posegaussian.storage.importers.common import (
    chosen,
    entries,
    folder,
    numbered,
    subfolders,
    videos_in,
)
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.evidence import UnitOptions, check_direction, metres
from posegaussian.storage.importers.masks import mask_streams
from posegaussian.storage.importers.posed_pictures import Files, picture_streams
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.images import PICTURE_SUFFIXES


class VideosOptions(UnitOptions):
    """Which calibration, where it is not the only one in the folder."""

    calibration: str | None = Field(None, description="Calibration file, or the folder of one file a camera.")


def find(source: Path, options: VideosOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    paths, form = _calibration(base, options.calibration)
    calibration = read_together(paths, form)
    path = paths[0] if len(paths) == 1 else paths[0].parent
    files = _files(base, calibration.cameras)
    if not files:
        raise SourceError(
            f"no NAME.mp4, videos/NAME.mp4 or images/NAME/000000.jpg in {base}, nor a folder in {base / 'videos'} named"
            f" as one of the cameras {', '.join(list(calibration.cameras)[:6])} with its video"
        )
    unknown = [n for n in files if n not in calibration.cameras]
    if len(unknown) == len(files):
        raise CalibrationError(
            f"{path} calibrates {', '.join(list(calibration.cameras)[:6])}, and there are {', '.join(unknown[:6])};"
            " a camera's name must be that of its video or folder, so rename one of them"
        )
    names = options.pick(tuple(n for n in files if n not in unknown))
    pictures, rate, notes = picture_streams({n: files[n] for n in names}, options)
    cameras = [calibration.cameras[n](s.size) for n, s in zip(names, pictures, strict=True)]
    for camera, stream in zip(cameras, pictures, strict=True):
        check_principal_point(f"camera {camera.name}", camera.intrinsics, camera.size, stream.size)
    centres = np.array([raw_centre(c) for c in cameras])
    said = options.scale is None and options.distance is None and calibration.metres is not None
    chosen_unit = options.model_copy(update={"scale": calibration.metres}) if said else options
    if said and not 0 < (calibration.metres or 0) <= 1e6:
        raise CalibrationError(f"{path}: {calibration.metres:g} m in a unit cannot be; say --option scale=METRES")
    scale, unit = metres(chosen_unit, names, centres, path.name)
    rig = build_rig(
        [c._replace(translation=c.translation * scale) for c in cameras],
        [s.size for s in pictures],
        half=calibration.half,
    )
    facing = check_direction(names, rig.rotations, rig.centres, calibration.direction)
    masks, mask_notes = mask_streams(names, [base / "masks" / n for n in names], pictures)
    return Capture(
        "videos",
        rig,
        rate,
        tuple(pictures),
        masks=masks,
        notes=(
            f"calibration: {', '.join(p.name for p in paths)}, {form.name}",
            *(f"{n} has no calibration in {path.name} and is left out" for n in unknown),
            f"unit: {scale:g} m, {calibration.unit_from}" if said else unit,
            *facing,
            *notes,
            *unread_times([base, base / "videos"]),
            *mask_notes,
        ),
    )


def _calibration(base: Path, given: str | None) -> tuple[list[Path], CalibrationFormat]:
    """The one file, or one file a camera, and their format. Raises CalibrationError."""
    known = ", ".join(f.name for f in FORMATS)
    path = chosen(base, given, "calibration")
    among = _in(path or base) if path is None or path.is_dir() else [path]
    found = [(p, f) for p in among for f in FORMATS if f.fits(p)]
    if len(found) == 1 or (found and found[0][1].alone and len({f.name for _, f in found}) == 1):
        return [p for p, _ in found], found[0][1]
    if path is not None and not found:
        raise CalibrationError(f"calibration {path} is of no format that is read: {known}")
    several = ", ".join(p.name for p, _ in found)
    raise CalibrationError(
        f"{path or base} holds {len(found)} calibrations{f' ({several})' if found else ''}; name one with --option"
        f" calibration=FILE. Read are {known}"
    )


def _in(base: Path) -> list[Path]:
    return sorted(p for p in entries(base) if p.is_file())


def _files(base: Path, known: Collection[str]) -> dict[str, Files]:
    videos = videos_in(base) or videos_of(base / "videos", known.__contains__)
    if videos:
        return dict(videos)
    return {f.name: n for f in subfolders(base / "images") if (n := numbered(f, PICTURE_SUFFIXES))}


def _has_files(base: Path) -> bool:
    return or_broken(lambda: _files(base, ()) or has_camera_folders(base / "videos", lambda _: True))


IMPORTER = Importer(
    "videos",
    "Videos or pictures of one's own with a calibration of another program.",
    VideosOptions,
    find,
    (
        Trait(
            f"calibration of {', '.join(f.name for f in FORMATS)}",
            lambda base: any(f.fits(p) and not f.left(p) for p in _in(base) for f in FORMATS),
        ),
        Trait(
            "NAME.mp4, videos/NAME.mp4, videos/NAME with a video or images/NAME",
            _has_files,
            filmed=True,
        ),
    ),
    masked=True,
)
