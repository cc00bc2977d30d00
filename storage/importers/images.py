"""Captures as folders of pictures and one JSON of cameras: the layout `exporters/images_layout.py` writes.

`images/NAME/<number>.png|jpg|exr`, `cameras.json`, and optionally `masks/NAME/<number>.png`, joints as
`joints/NAME.json` (COCO), `joints.json` (COCO, all views) or `joints/NAME/<number>.json` (OpenPose),
`depth_maps/NAME/<number>.exr|png|tif` to reconstruct from, and a simulator's truth `depth/NAME/<number>.exr`.
`cameras.json` is

    {"pixel_center": "integer" | "half", "frame_rate": 30,
     "cameras": [{"name", "width", "height", "K", "R", "t", "distortion"?, "held_out"?}]}

world to camera, OpenCV axes, metres unless the option `scale` or `distance` says the unit; `"held_out": true` marks a
camera that only metrics may look at.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from posegaussian.storage.formats.joint_files import read_openpose
from posegaussian.storage.importers.cameras import RawCamera, build_rig, numbers, raw_centre
from posegaussian.storage.importers.common import (
    file_stream,
    folder,
    gap_notes,
    has_pictures,
    image_stream,
    numbered,
    subfolders,
)
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.depth_streams import depth_map_streams
from posegaussian.storage.importers.evidence import UnitOptions, metres
from posegaussian.storage.importers.joint_streams import coco_joints, picture_joints
from posegaussian.storage.importers.masks import mask_streams
from posegaussian.storage.model.capture import Capture, Stream
from posegaussian.storage.model.documents import read_json
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers import images


class ImagesOptions(UnitOptions):
    """The layout leaves little else to choose; without a unit of the user's, lengths are metres."""

    depth_scale: float | None = Field(
        None,
        gt=0,
        le=1000,
        description=(
            "Metres per unit of the depth maps; by default the poses' unit for float files, while integers are refused."
        ),
    )


class CameraEntry(BaseModel):
    """One camera of `cameras.json`."""

    model_config = ConfigDict(extra="ignore")
    name: str
    width: int = Field(gt=0)
    height: int = Field(gt=0)
    K: list[Any]
    R: list[Any]
    t: list[Any]
    distortion: list[Any] = []
    held_out: bool = False


class CamerasFile(BaseModel):
    """`cameras.json`."""

    model_config = ConfigDict(extra="ignore")
    pixel_center: Literal["integer", "half"]
    frame_rate: float | None = Field(None, gt=0)
    cameras: list[CameraEntry]


def find(source: Path, options: ImagesOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    cameras = _cameras(base / "cameras.json")
    found = {f.name: n for f in subfolders(base / "images") if (n := numbered(f, images.PICTURE_SUFFIXES))}
    if not found:
        raise SourceError(f"no pictures in {base / 'images'}: expected images/NAME/<number>.png, .jpg or .exr")
    entries = {c.name: c for c in cameras.cameras}
    names = options.pick(tuple(c for c in entries if c in found) + tuple(n for n in found if n not in entries))
    for name in names:
        if name not in entries:
            raise CalibrationError(
                f"pictures {base / 'images' / name} have no camera in {base / 'cameras.json'}, which names"
                f" {', '.join(entries) or 'none'}; add it there, or name the cameras to import with --option"
                f" {shlex.quote('cameras=' + ','.join(n for n in entries if n in found))}"
            )
    notes = [
        f"camera {n} has no pictures and is left out" for n in entries if n not in found and options.cameras is None
    ]
    pictures = [image_stream(n, found[n]) for n in names]
    rate = options.frame_rate or cameras.frame_rate or 30.0
    if not (options.frame_rate or cameras.frame_rate):
        notes.append("30 frames/s assumed; give frame_rate in cameras.json")
    raw = [_camera(entries[n]) for n in names]
    scale = 1.0
    if options.scale is not None or options.distance is not None:
        scale, unit = metres(options, names, np.array([raw_centre(c) for c in raw]), "cameras.json")
        notes.append(unit)
    rig = build_rig(
        [c._replace(translation=c.translation * scale) for c in raw],
        [s.size for s in pictures],
        cameras.pixel_center == "half",
    )
    masks, more = mask_streams(names, [base / "masks" / n for n in names], pictures)
    joints, joint_notes = _joints(base, names, pictures, options.joint_set)
    depth, depth_notes = _depth(base, names, pictures, scale)
    depth_maps, map_notes = depth_map_streams(
        names, [base / "depth_maps" / n for n in names], pictures, options.depth_scale, scale
    )
    if options.depth_scale is not None and not depth_maps:
        raise SourceError(
            f"--option depth_scale={options.depth_scale:g}: {base / 'depth_maps'} has no depth maps of these pictures;"
            " put them there as depth_maps/NAME/<number>.exr, .png or .tif, or leave the option out"
        )
    notes += [*more, *joint_notes, *depth_notes, *map_notes]
    held_out = tuple(n for n in names if entries[n].held_out)
    return Capture(
        "images",
        rig,
        rate,
        tuple(pictures),
        masks=masks,
        joints=joints,
        depth=depth,
        depth_maps=depth_maps,
        held_out=held_out,
        notes=tuple(notes),
    )


def _cameras(path: Path) -> CamerasFile:
    try:
        out = CamerasFile.model_validate(read_json(path))
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    except ValidationError as e:
        faults = [f"{'.'.join(map(str, f['loc'])) or 'the file'}: {f['msg']}" for f in e.errors()]
        raise CalibrationError(f"{path} does not describe cameras: {'; '.join(faults)}") from e
    names = [c.name for c in out.cameras]
    for name in names:
        if names.count(name) > 1:
            raise CalibrationError(
                f"{path}: camera name {name!r} occurs {names.count(name)} times; names must be unique"
            )
    if not names:
        raise CalibrationError(f"{path} names no cameras")
    return out


def _camera(c: CameraEntry) -> RawCamera:
    return RawCamera(
        c.name,
        numbers(c.K, c.name, "K", [(3, 3)]),
        numbers(c.distortion, c.name, "distortion", [(-1,)]),
        numbers(c.R, c.name, "R", [(3, 3)]),
        numbers(c.t, c.name, "t", [(3,)]),
        (c.width, c.height),
    )


def _joints(
    base: Path, names: Sequence[str], pictures: Sequence[Stream], given: str | None
) -> tuple[tuple[Stream | None, ...], list[str]]:
    shared, own = base / "joints.json", {n: base / "joints" / f"{n}.json" for n in names}
    own = {n: p for n, p in own.items() if p.is_file()}
    folders = {n: f for n in names if (f := numbered(base / "joints" / n, (".json",)))}
    fitting = [
        what
        for what, there in (
            ("joints.json", shared.is_file()),
            ("joints/NAME.json", own),
            ("joints/NAME/<number>.json", folders),
        )
        if there
    ]
    if len(fitting) > 1:
        raise SourceError(f"{base} holds joints as {' and as '.join(fitting)}; keep one of them")
    if folders:
        return picture_joints("openpose", read_openpose, names, folders, pictures, given, "joints")
    if shared.is_file():
        return coco_joints(names, dict.fromkeys(names, shared), True, pictures, given)
    return coco_joints(names, own, False, pictures, given)


def _depth(
    base: Path, names: Sequence[str], pictures: Sequence[Stream], scale: float
) -> tuple[tuple[Stream | None, ...], list[str]]:
    streams: list[Stream | None] = []
    scaled = {} if scale == 1 else {"scale": scale}
    for name, stream in zip(names, pictures, strict=True):
        files = {n: p for n, p in numbered(base / "depth" / name, (".exr",)).items() if n in set(stream.numbers)}
        for n, p in files.items():
            if (size := images.picture_size(p)) != tuple(stream.size):
                raise SourceError(
                    f"camera {name}, frame {n}: depth {p} is {size[0]}x{size[1]} px, its picture is"
                    f" {stream.size[0]}x{stream.size[1]} px"
                )
        streams.append(file_stream("images", files, stream.size, **scaled) if files else None)
    if not any(streams):
        return (), []
    without = [f"camera {n} has no true depth" for n, s in zip(names, streams, strict=True) if s is None]
    return tuple(streams), without + gap_notes(names, streams, [np.asarray(s.numbers) for s in pictures], "true depth")


def _has_cameras_json(base: Path) -> bool:
    if not (base / "cameras.json").is_file():
        return False
    data: Any = read_json(base / "cameras.json")
    return isinstance(data, dict) and "cameras" in data


IMPORTER = Importer(
    "images",
    "Folders of pictures and one cameras.json, optionally masks, joints, depth maps and true depth.",
    ImagesOptions,
    find,
    (
        Trait("cameras.json that lists cameras", lambda base: or_broken(lambda: _has_cameras_json(base))),
        Trait("pictures images/NAME/<number>.png, .jpg or .exr", has_pictures, filmed=True),
    ),
    by_definition=True,
    masked=True,
)
