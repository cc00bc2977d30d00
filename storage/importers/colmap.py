"""Rigs that COLMAP calibrated: its sparse model, text or binary, and the cameras' pictures or videos.

The model lies in `sparse/0`, `sparse` or the folder itself, pictures in `images/CAM/000000.jpg` or `videos/CAM.mp4`;
`images/CAM.jpg`, one picture a camera, is a single instant unless there are videos or folders of that name. Rigs'
models (`rigs`, `frames`) are read by their images' poses. Masks, white where the subject is, in `masks/` under the
pictures' names, `.png` appended or in place of their ending, or as `masks/CAM/000000.png`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from posegaussian.storage.formats.colmap_model import ColmapCamera, ColmapModel, model_form, read_model
from posegaussian.storage.importers.cameras import DISTORTION, build_rig
from posegaussian.storage.importers.common import (
    chosen,
    entries,
    folder,
    shown,
    subfolders,
)
from posegaussian.storage.importers.declaration import Importer, Trait
from posegaussian.storage.importers.evidence import (
    Seen,
    check_direction,
    check_points,
    metres,
)
from posegaussian.storage.importers.mask_files import masks_beside
from posegaussian.storage.importers.masks import mask_file_streams
from posegaussian.storage.importers.posed_images import (
    Cameras,
    PosedImage,
    checked_name,
    sorted_by_camera,
    still_camera,
)
from posegaussian.storage.importers.posed_pictures import PosedOptions, picture_files, picture_streams
from posegaussian.storage.model.cameras import points_to_integer_centres, to_integer_centres
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError
from posegaussian.storage.model.plausible import check_size

DIRECTION = "world to camera"
ELSEWHERE = "say where with the option images"
POINTS_A_CAMERA = 2000
"""Observations of a camera that are compared with the points."""


class ColmapOptions(PosedOptions):
    """What to take where several fit; paths are relative to the capture's folder."""

    model: str | None = Field(
        None, description="Folder of the model; by default sparse/0, sparse or the folder itself."
    )
    images: str = Field("images", description="Folder that the images' names are relative to.")
    pixel_center: Literal["half", "integer"] = Field(
        "half", description="Centre of the first pixel in the principal points, 0.5 as COLMAP has it, or 0."
    )


def find(source: Path, options: ColmapOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    place = _model_folder(base, options)
    model = read_model(place)
    posed = _posed(model, place, options)
    cameras = sorted_by_camera(posed, options.moment)
    files, notes = picture_files(base, base / options.images, cameras, options.pictures, ELSEWHERE)
    names = options.pick(tuple(files))
    if options.cameras is None:
        notes += [f"camera {n} is placed but has no pictures and is left out" for n in cameras.images if n not in files]
    middle = {n: still_camera(n, group, 1.0) for n, group in cameras.images.items()}
    rotations = np.array([c.rotation for c in middle.values()])
    centres = np.array([-c.rotation.T @ c.translation for c in middle.values()])
    scale, unit = metres(options, tuple(middle), centres, "COLMAP")
    fit = check_points(_seen(model, cameras, options), DIRECTION)
    facing = check_direction(tuple(middle), rotations, centres, DIRECTION)
    pictures, rate, more = picture_streams({n: files[n] for n in names}, options)
    rig = build_rig(
        [still_camera(n, cameras.images[n], scale) for n in names],
        [s.size for s in pictures],
        half=options.pixel_center == "half",
    )
    beside = [masks_beside(base / "masks", base / options.images, n, files[n]) for n in names]
    masks, mask_notes = mask_file_streams(names, beside, pictures)
    return Capture(
        "colmap",
        rig,
        rate,
        tuple(pictures),
        masks=masks,
        notes=(
            f"model: {model.form}, {shown(base, [place])}, {len(model.images)} images",
            *cameras.notes,
            *notes,
            unit,
            *facing,
            *fit,
            *more,
            *mask_notes,
        ),
    )


def _model_folders(base: Path) -> list[Path]:
    """Folders with a model: those numbered in sparse, sparse, the folder itself."""
    places = [*subfolders(base / "sparse"), base / "sparse", base / "colmap" / "sparse" / "0", base]
    return [p for p in places if model_form(p)]


def _model_folder(base: Path, options: ColmapOptions) -> Path:
    if given := chosen(base, options.model, "model"):
        return given
    found = _model_folders(base)
    if not found:
        raise CalibrationError(
            f"no COLMAP model in {base}: expected cameras and images, .txt or .bin, in sparse/0, sparse or the folder"
            " itself; name another place with the option model"
        )
    if len(found) > 1:
        raise CalibrationError(
            f"several models fit: {shown(base, found)}; each has a frame of reference of its own, so choose one with"
            " the option model"
        )
    return found[0]


def _posed(model: ColmapModel, place: Path, options: ColmapOptions) -> list[PosedImage]:
    out = []
    known: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for image in model.images:
        if image.camera not in known:
            where = f"model {place}, image {image.name[:200]!r}, camera {image.camera}"
            known[image.camera] = opencv_camera(model.cameras[image.camera], where)
        intrinsics, distortion = known[image.camera]
        name = checked_name(image.name, str(place))
        with np.errstate(over="ignore", invalid="ignore"):
            centre = -image.rotation.T @ image.translation
        size = model.cameras[image.camera].size
        check_size(f"{image.camera} of {place}", *size)
        out.append(PosedImage(name, intrinsics, distortion, image.rotation, centre, size))
    return out


def opencv_camera(camera: ColmapCamera, where: str) -> tuple[np.ndarray, np.ndarray]:
    """(intrinsics [3, 3] with pixel centres as in the file, distortion [8] k1 k2 p1 p2 k3 k4 k5 k6).

    Raises CalibrationError for a model that OpenCV's rational one does not hold.
    """
    p, model = camera.params, camera.model
    one = model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
    if not one and model not in ("PINHOLE", "OPENCV", "FULL_OPENCV"):
        raise CalibrationError(
            f"{where}: camera model {model} is no case of OpenCV's k1 k2 p1 p2 k3 k4 k5 k6, which alone is read; run"
            " `colmap image_undistorter`, or calibrate with --ImageReader.camera_model OPENCV or FULL_OPENCV"
        )
    fx, fy, cx, cy, *distortion = (p[0], *p) if one else p
    padded = np.pad(np.array(distortion, dtype=np.float64), (0, DISTORTION - len(distortion)))
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), padded


def _seen(model: ColmapModel, cameras: Cameras, options: ColmapOptions) -> list[Seen]:
    """The points in every camera's images."""
    owner = {i.name: camera for camera, group in cameras.images.items() for i in group.values()}
    left = dict.fromkeys(cameras.images, POINTS_A_CAMERA)
    out = []
    for image in model.images:
        camera = owner[checked_name(image.name, "")]
        if not left[camera]:
            continue
        known = [k for k, p in enumerate(image.points) if int(p) in model.points][: left[camera]]
        if not known:
            continue
        left[camera] -= len(known)
        intrinsics, distortion = opencv_camera(model.cameras[image.camera], image.name)
        if not (np.isfinite(intrinsics).all() and np.isfinite(distortion).all()):
            continue  # said when the rig is made
        points = np.array([model.points[int(image.points[k])] for k in known])
        half = options.pixel_center == "half"
        out.append(
            Seen(
                camera,
                to_integer_centres(intrinsics) if half else intrinsics,
                distortion,
                image.rotation,
                image.translation,
                points_to_integer_centres(image.pixels[known]),
                points,
                max(model.cameras[image.camera].size),
            )
        )
    return out


def _has_pictures(base: Path) -> bool:
    found: Sequence[Path] = [base / "images", base / "videos"]
    return any(map(entries, found))


IMPORTER = Importer(
    "colmap",
    "A sparse model of COLMAP, text or binary, and pictures or videos of cameras that stand still.",
    ColmapOptions,
    find,
    (
        Trait("cameras and images, .txt or .bin, in sparse/0, sparse or the folder", lambda b: bool(_model_folders(b))),
        Trait("pictures in images or videos", _has_pictures, filmed=True),
    ),
    masked=True,
)
