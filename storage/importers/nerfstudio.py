"""Rigs in nerfstudio's or Blender's `transforms.json`: posed images, with masks and depth where the file names them.

Poses are camera to world with OpenGL axes (x right, y up, z backwards), a unit of their own; the first pixel's centre
lies at (0.5, 0.5), as ours. Intrinsics stand in the file's head or with each frame, or follow from `camera_angle_x`;
`time` or numbers in names tell instants. `transforms_train.json` and `transforms_test.json`, as Blender scenes have
them, are read together, the latter's cameras held out. Format: https://docs.nerf.studio, data conventions, and
nerfstudio/data/dataparsers/nerfstudio_dataparser.py.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from posegaussian.storage.importers.cameras import DISTORTION, build_rig, numbers
from posegaussian.storage.importers.common import chosen, folder
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.depth_streams import depth_file_streams
from posegaussian.storage.importers.evidence import check_direction, metres
from posegaussian.storage.importers.mask_files import masks_beside
from posegaussian.storage.importers.masks import mask_file_streams
from posegaussian.storage.importers.posed_images import (
    PosedImage,
    checked_name,
    instants,
    sorted_by_camera,
    still_camera,
)
from posegaussian.storage.importers.posed_pictures import PosedOptions, picture_files, picture_streams
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.documents import read_json, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers import images

FILES = ("transforms.json", "transforms_train.json")
"""Names of the file, the first that is there."""
TEST = "transforms_test.json"
"""Beside transforms_train.json: cameras that only metrics look at."""
PERSPECTIVE = ("", "PERSPECTIVE", "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
"""Camera models that are read, by `camera_model`."""
LABELS = ("camera_label", "camera_name", "camera", "camera_id")
"""Keys of a frame that name its camera."""
ENDINGS = (".png", ".jpg", ".jpeg", ".exr")
"""What may be missing from `file_path`."""
DIRECTION = "camera to world"
ELSEWHERE = "put it there, or correct its file_path"
OPENGL = np.diag([1.0, -1.0, -1.0])
"""From OpenGL's camera axes to OpenCV's, and back."""
MILLIMETRE = 1e-3
"""Units of the poses in one of an integer depth map."""


class NerfstudioOptions(PosedOptions):
    """What to take where several fit."""

    transforms: str | None = Field(
        None, description="The file; by default transforms.json, else transforms_train.json and transforms_test.json."
    )
    pixel_center: Literal["half", "integer"] = Field(
        "half", description="Centre of the first pixel in cx and cy, 0.5 as nerfstudio has it, or 0."
    )
    depth_scale: float | None = Field(
        None,
        gt=0,
        le=1000,
        description="Metres per unit of the depth maps; by default a thousandth of the poses' unit for integers, the"
        " poses' unit for floats.",
    )


class _Frame:
    """One frame of a file."""

    def __init__(self, base: Path, head: Mapping[str, Any], frame: Mapping[str, Any], where: str) -> None:
        self.base, self.head, self.frame, self.where = base, head, frame, where

    def number(self, key: str) -> float | None:
        """A number of the frame or of the head; None where neither has it. Raises CalibrationError where they differ,
        as readers of this format do not agree on which holds."""
        found = {float(_number(d[key], f"{self.where}: {key}")) for d in (self.head, self.frame) if key in d}
        if len(found) > 1:
            raise CalibrationError(
                f"{self.where}: {key} is {self.frame[key]:g} here and {self.head[key]:g} in the file's head; take one"
                " of the two out"
            )
        return found.pop() if found else None

    def path(self, key: str) -> str | None:
        """A path below the capture's folder; None where the frame has none."""
        value = self.frame.get(key)
        if value is None:
            return None
        if not isinstance(value, str):
            raise SourceError(f"{self.where}: {key} {shortened(value)} is no path")
        own = Path(value).is_relative_to(self.base)  # written in full, as some programs do
        return checked_name(str(Path(value).relative_to(self.base)) if own else value, self.where)


def find(source: Path, options: NerfstudioOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    files = _files(base, options)
    frames = [f for path in files for f in _frames(base, path)]
    applied = _applied(frames[0]) if options.scale is None else 1.0
    posed = [_posed(base, f, applied) for f in frames]
    posed, notes = instants(posed, [f.number("time") for f in frames])
    by_name = {i.name: f for i, f in zip(posed, frames, strict=True)}
    if len(by_name) < len(frames):
        twice = next(name for name, n in Counter(i.name for i in posed).items() if n > 1)
        raise SourceError(f"{files[0]}: image {twice} is there twice; write the file again")
    cameras = sorted_by_camera(posed, options.moment)
    found, more = picture_files(base, base, cameras, options.pictures, ELSEWHERE)
    names = options.pick(tuple(found))
    without = [n for n in cameras.images if n not in found and options.cameras is None]
    middle = {n: still_camera(n, group, 1.0) for n, group in cameras.images.items()}
    rotations = np.array([c.rotation for c in middle.values()])
    centres = np.array([-c.rotation.T @ c.translation for c in middle.values()])
    scale, unit = metres(options, tuple(middle), centres, "transforms.json")
    facing = check_direction(tuple(middle), rotations, centres, DIRECTION)
    pictures, rate, rate_notes = picture_streams({n: found[n] for n in names}, options)
    rig = build_rig(
        [still_camera(n, cameras.images[n], scale) for n in names],
        [s.size for s in pictures],
        half=options.pixel_center == "half",
    )
    own = {n: {k: by_name[i.name] for k, i in cameras.images[n].items()} for n in names}
    named = [_named(base, own[n], "mask_path") for n in names]
    if not any(named):
        named = [masks_beside(base / "masks", base / "images", n, found[n]) for n in names]
    masks, mask_notes = mask_file_streams(names, named, pictures)
    maps = [_named(base, own[n], "depth_file_path") for n in names]
    depth_maps, depth_notes = depth_file_streams(names, maps, pictures, _depth_scale(options, maps, scale / applied))
    held_out = _held_out(files, names, own)
    return Capture(
        "nerfstudio",
        rig,
        rate,
        tuple(pictures),
        masks=masks,
        depth_maps=depth_maps,
        held_out=held_out,
        notes=(
            f"cameras of {', '.join(p.name for p in files)}, {len(frames)} frames",
            *cameras.notes,
            *notes,
            *more,
            *(f"camera {n} is placed but has no pictures and is left out" for n in without),
            unit,
            *([f"applied_scale {applied:g} is undone"] if applied != 1 else []),
            *facing,
            *rate_notes,
            *mask_notes,
            *depth_notes,
        ),
    )


def _files(base: Path, options: NerfstudioOptions) -> list[Path]:
    if given := chosen(base, options.transforms, "transforms"):
        return [given]
    found = [base / name for name in FILES if (base / name).is_file()][:1]
    if not found:
        raise CalibrationError(f"no transforms.json and no transforms_train.json in {base}")
    test = base / TEST
    return [*found, test] if found[0].name != FILES[0] and test.is_file() else found


def _frames(base: Path, path: Path) -> list[_Frame]:
    try:
        data = read_json(path, "cameras")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(f, dict) for f in frames):
        raise CalibrationError(f"{path} has no list of frames; give transforms.json as nerfstudio or Blender writes it")
    return [_Frame(base, data, f, f"{path}, frame {at}") for at, f in enumerate(frames)]


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise CalibrationError(f"{what}: {shortened(value)} is not a finite number")
    return float(value)


def _applied(frame: _Frame) -> float:
    """By which the file's writer scaled the poses."""
    scale = _number(frame.head.get("applied_scale", 1.0), f"{frame.where}: applied_scale")
    if not 1e-6 <= scale <= 1e6:
        raise CalibrationError(f"{frame.where}: applied_scale {scale:g} must be between 1e-6 and 1e6")
    return scale


def _posed(base: Path, frame: _Frame, applied: float) -> PosedImage:
    named = frame.path("file_path")
    if named is None:
        raise CalibrationError(f"{frame.where} has no file_path")
    name = _with_ending(base, named)
    pose = numbers(frame.frame.get("transform_matrix"), named, "transform_matrix", [(4, 4), (3, 4)])
    if not np.isfinite(pose).all():
        raise CalibrationError(f"{frame.where}: transform_matrix holds a number that is not finite")
    if pose.shape == (4, 4) and not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise CalibrationError(
            f"{frame.where}: the last row of transform_matrix is {pose[3].tolist()}, a rigid motion's is [0, 0, 0, 1];"
            " is it transposed?"
        )
    size = _size(base / name, frame)
    label = next((str(frame.frame[k]) for k in LABELS if isinstance(frame.frame.get(k), str | int)), None)
    intrinsics, distortion = _camera(frame, size)
    return PosedImage(name, intrinsics, distortion, OPENGL @ pose[:3, :3].T, pose[:3, 3] / applied, size, label)


def _with_ending(base: Path, name: str) -> str:
    """The name of the file; Blender leaves the ending away."""
    if Path(name).suffix.lower() in images.PICTURE_SUFFIXES:
        return name
    return next((name + e for e in ENDINGS if (base / (name + e)).is_file()), name + ENDINGS[0])


def _size(path: Path, frame: _Frame) -> tuple[int, int]:
    """(width, height) px that the intrinsics are for: as the file says, else the picture's."""
    w, h = frame.number("w"), frame.number("h")
    if w is None or h is None:
        return images.picture_size(path)
    if not (w == int(w) and h == int(h) and 0 < w < 1e6 and 0 < h < 1e6):
        raise CalibrationError(f"{frame.where}: w {w:g} and h {h:g} must be positive whole numbers")
    return int(w), int(h)


def _camera(frame: _Frame, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(intrinsics [3, 3] px, distortion [8] k1 k2 p1 p2 k3 ...). Raises CalibrationError for another model."""
    model = frame.frame.get("camera_model", frame.head.get("camera_model", ""))
    fisheye = frame.head.get("is_fisheye") or frame.frame.get("is_fisheye")
    if model not in PERSPECTIVE or fisheye:
        raise CalibrationError(
            f"{frame.where}: camera model {'is_fisheye' if fisheye else shortened(model)} is no case of OpenCV's k1 k2"
            " p1 p2 k3, which alone is read; undistort the pictures and write PINHOLE, or calibrate with OPENCV"
        )
    if frame.number("k4"):
        raise CalibrationError(
            f"{frame.where}: k4 is of the eighth power of the radius here, which OpenCV's model has not (its k4 is"
            " another); calibrate with k1 k2 p1 p2 k3"
        )
    fx = _focal(frame, "fl_x", "camera_angle_x", size[0])
    fy = _focal(frame, "fl_y", "camera_angle_y", size[1])
    fx, fy = fx or fy, fy or fx
    if fx is None or fy is None:
        raise CalibrationError(f"{frame.where} has neither fl_x nor camera_angle_x")
    cx, cy = frame.number("cx"), frame.number("cy")
    centre = (size[0] / 2 if cx is None else cx, size[1] / 2 if cy is None else cy)
    distortion = np.zeros(DISTORTION)
    distortion[:5] = [frame.number(k) or 0.0 for k in ("k1", "k2", "p1", "p2", "k3")]
    return np.array([[fx, 0, centre[0]], [0, fy, centre[1]], [0, 0, 1]]), distortion


def _focal(frame: _Frame, key: str, angle_key: str, extent: int) -> float | None:
    focal, angle = frame.number(key), frame.number(angle_key)
    if focal is not None or angle is None:
        return focal
    if not 0 < angle < np.pi:
        raise CalibrationError(f"{frame.where}: {angle_key} {angle:g} must be an angle between 0 and pi, in radians")
    return float(0.5 * extent / np.tan(0.5 * angle))


def _named(base: Path, frames: Mapping[int, _Frame], key: str) -> dict[int, Path]:
    """{source frame number: file} that the frames of a camera name."""
    return {n: base / named for n, f in frames.items() if (named := f.path(key)) is not None}


def _depth_scale(options: NerfstudioOptions, maps: Sequence[Mapping[int, Path]], scale: float) -> float | None:
    first = next((p for m in maps for p in m.values()), None)
    if options.depth_scale is not None or first is None:
        return options.depth_scale
    return scale * (MILLIMETRE if images.holds_integers(first) else 1.0)


def _held_out(files: Sequence[Path], names: Sequence[str], own: Mapping[str, Mapping[int, _Frame]]) -> tuple[str, ...]:
    """Cameras of transforms_test.json alone, and those whose images are all in `test_filenames`."""
    heads = {id(f.head): f.head for frames in own.values() for f in frames.values()}
    listed = {
        key: {t for t in tests if isinstance(t, str)}
        if isinstance(tests := head.get("test_filenames"), list)
        else set()
        for key, head in heads.items()
    }
    out = []
    for n in names:
        tested = [
            f.where.startswith(f"{files[-1]},") if len(files) > 1 else f.frame["file_path"] in listed[id(f.head)]
            for f in own[n].values()
        ]
        if all(tested):
            out.append(n)
    return tuple(out) if len(out) < len(names) else ()


def _is_transforms(base: Path) -> bool:
    path = next((base / name for name in FILES if (base / name).is_file()), None)
    data: Any = read_json(path) if path else None
    return isinstance(data, dict) and "frames" in data


IMPORTER = Importer(
    "nerfstudio",
    "transforms.json of nerfstudio or Blender, with the pictures, masks and depth maps that it names.",
    NerfstudioOptions,
    find,
    (
        Trait(
            "transforms.json or transforms_train.json with frames", lambda base: or_broken(lambda: _is_transforms(base))
        ),
    ),
    masked=True,
)
