"""Captures in EasyMocap's layout, which EasyVolcap shares.

`images/NAME/000000.jpg` or `videos/NAME.mp4`, `intri.yml` and `extri.yml` (OpenCV FileStorage, metres, world to
camera), soft masks in `masks/NAME` or `mask/NAME`, `annots/NAME/000000.json`. Calibration, joints and boxes put pixel
centres at integers. Format: https://github.com/zju3dv/EasyMocap, doc/02_output.md and quickstart.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field
from ruamel.yaml.nodes import MappingNode

from posegaussian.storage.formats.joint_files import read_easymocap
from posegaussian.storage.importers.camera_folders import has_camera_folders, videos_of
from posegaussian.storage.importers.cameras import RawCamera, build_rig, check_principal_point, numbers
from posegaussian.storage.importers.common import (
    ImportOptions,
    folder,
    has_pictures,
    image_stream,
    numbered,
    subfolders,
    videos_in,
)
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.films import video_streams
from posegaussian.storage.importers.joint_streams import picture_joints
from posegaussian.storage.importers.masks import mask_streams
from posegaussian.storage.model.cameras import rotation_matrix
from posegaussian.storage.model.capture import Capture, Stream
from posegaussian.storage.model.documents import shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.model.yaml_documents import TextConstructor, TextResolver, loader, parse
from posegaussian.storage.readers import images as media

BOTH = "R_ and Rot_ are different rotations; Rot_ is taken, and EasyMocap itself reads R_"
DEFAULT_RATE = 30.0
"""Frames per second of folders of images, which do not say theirs."""


class EasyMocapOptions(ImportOptions):
    """What to take where several fit."""

    pictures: Literal["auto", "images", "videos"] = Field(
        "auto", description="Folder of the pictures; auto takes images where there are any."
    )


def find(source: Path, options: EasyMocapOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    intri, extri = read_opencv_yaml(base / "intri.yml"), read_opencv_yaml(base / "extri.yml")
    calibrated = _names(intri, base / "intri.yml")
    names, pictures, rate, notes = _pictures(base, options, calibrated)
    for name in names:
        if name not in calibrated:
            raise CalibrationError(
                f"camera {name} has pictures but is not in {base / 'intri.yml'}, which names {', '.join(calibrated)};"
                " list the wanted ones in the option cameras"
            )
    if options.cameras is None:
        notes += [f"calibration {n} has no pictures and is left out" for n in calibrated if n not in names]
    cameras = [_camera(n, intri, extri) for n in names]
    for camera, stream in zip(cameras, pictures, strict=True):
        if camera.size is None:  # of the picture's own size, which its principal point shows
            check_principal_point(f"camera {camera.name}", camera.intrinsics, None, stream.size)
    rig = build_rig(cameras, [s.size for s in pictures], half=False)
    notes += [f"camera {n}: {BOTH}" for n in names if _differ(n, extri)]
    mask_root = next((base / f for f in ("masks", "mask") if (base / f).is_dir()), base / "masks")
    masks, more = mask_streams(names, [mask_root / n for n in names], pictures)
    notes += more
    files = {n: numbered(base / "annots" / n, (".json",)) for n in names}
    joints, more = picture_joints("easymocap", read_easymocap, names, files, pictures, options.joint_set, "annots")
    return Capture("easymocap", rig, rate, tuple(pictures), masks=masks, joints=joints, notes=(*notes, *more))


def _pictures(
    base: Path, options: EasyMocapOptions, calibrated: Collection[str]
) -> tuple[tuple[str, ...], list[Stream], float, list[str]]:
    """(camera names, pictures, frames per second, notes)."""
    images = (
        {f.name: n for f in subfolders(base / "images") if (n := numbered(f, media.PICTURE_SUFFIXES))}
        if options.pictures != "videos"
        else {}
    )
    videos = videos_of(base / "videos", calibrated.__contains__) if options.pictures != "images" and not images else {}
    if not (images or videos):
        raise SourceError(f"no pictures in {base}: expected images/NAME/000000.jpg or videos/NAME.mp4")
    if images:
        names = options.pick(tuple(images))
        streams = [image_stream(n, images[n]) for n in names]
        rate = options.frame_rate or DEFAULT_RATE
        notes = [f"pictures: images at {rate:g} frames/s{'' if options.frame_rate else ' (assumed; set frame_rate)'}"]
    else:
        names = options.pick(tuple(videos))
        streams, rate, notes = video_streams({n: videos[n] for n in names}, options.frame_rate)
    return names, streams, rate, notes


class _Constructor(TextConstructor):
    """Builds texts and matrices. Every scalar stays text: a camera named 01 stays 01, and OpenCV's .Nan is seen."""

    def construct_matrix(self, node: MappingNode) -> np.ndarray:
        """OpenCV's matrix. Raises ValueError, KeyError or TypeError for what is none."""
        fields: dict[Any, Any] = self.construct_mapping(node, deep=True)
        return np.array([_number(x) for x in fields["data"]]).reshape(int(fields["rows"]), int(fields["cols"]))


_Constructor.add_constructor("tag:yaml.org,2002:opencv-matrix", _Constructor.construct_matrix)


def _number(text: Any) -> float:
    if not isinstance(text, str):
        raise ValueError(f"{shortened(text)} is not a number")
    return float(text.replace(".Nan", "nan").replace(".Inf", "inf"))


def _without_version(text: str) -> Any:
    """What the text holds; OpenCV's first line, %YAML:1.0, is none that YAML knows."""
    known = "\n".join("" if line.startswith("%YAML") else line for line in text.split("\n"))
    return loader(_Constructor, TextResolver).load(known)


def read_opencv_yaml(path: Path) -> dict[str, Any]:
    """The nodes of an OpenCV FileStorage YAML:
    matrices as float64 arrays, lists, and scalars as text. Raises CalibrationError."""
    try:
        data = parse(_without_version, path, "calibration")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    if not isinstance(data, dict):
        raise CalibrationError(f"calibration {path} holds no nodes")
    return data


def _names(intri: Mapping[str, Any], path: Path) -> tuple[str, ...]:
    names = intri.get("names") or [k[2:] for k in intri if k.startswith("K_")]
    for n in names:
        if list(names).count(n) > 1:
            raise CalibrationError(
                f"{path}: camera name {n!r} occurs {list(names).count(n)} times; names must be unique"
            )
    return tuple(names)


def _node(data: Mapping[str, Any], keys: Sequence[str], file: str, name: str) -> Any:
    for key in keys:
        if key in data:
            return data[key]
    raise CalibrationError(f"camera {name}: {file} has no {' or '.join(keys)}")


def _differ(name: str, extri: Mapping[str, Any]) -> bool:
    """Whether a camera has both spellings of its rotation, and they are not the same to the digits of the files."""
    if f"R_{name}" not in extri or f"Rot_{name}" not in extri:
        return False
    vector = numbers(extri[f"R_{name}"], name, f"R_{name}", [(3,), (3, 3)])
    matrix = numbers(extri[f"Rot_{name}"], name, f"Rot_{name}", [(3, 3), (3,)])
    turns = [rotation_matrix(r) if r.size == 3 else r for r in (vector, matrix)]
    return not np.abs(turns[0] - turns[1]).max() < 1e-4


def _camera(name: str, intri: Mapping[str, Any], extri: Mapping[str, Any]) -> RawCamera:
    distortion = intri.get(f"D_{name}", intri.get(f"dist_{name}", []))
    try:
        size = (
            (int(_number(intri[f"W_{name}"])), int(_number(intri[f"H_{name}"])))
            if f"W_{name}" in intri and f"H_{name}" in intri
            else None
        )
    except (ValueError, OverflowError):
        raise CalibrationError(
            f"camera {name}: W_{name} {intri[f'W_{name}']!r}"
            f" and H_{name} {intri[f'H_{name}']!r} in intri.yml must be whole numbers"
        ) from None
    return RawCamera(
        name,
        numbers(_node(intri, [f"K_{name}"], "intri.yml", name), name, f"K_{name}", [(3, 3)]),
        numbers(distortion, name, f"D_{name}", [(-1,)]),
        numbers(_node(extri, [f"Rot_{name}", f"R_{name}"], "extri.yml", name), name, f"R_{name}", [(3,), (3, 3)]),
        numbers(_node(extri, [f"T_{name}"], "extri.yml", name), name, f"T_{name}", [(3,)]),
        size,
    )


def _has_files(base: Path) -> bool:
    videos = base / "videos"
    return has_pictures(base) or or_broken(lambda: videos_in(videos) or has_camera_folders(videos, lambda _: True))


IMPORTER = Importer(
    "easymocap",
    "Images or videos, intri.yml and extri.yml, soft masks and annots, as EasyMocap has them.",
    EasyMocapOptions,
    find,
    (
        Trait("intri.yml", lambda base: (base / "intri.yml").is_file()),
        Trait("extri.yml", lambda base: (base / "extri.yml").is_file()),
        Trait(
            "images/NAME/000000.jpg or videos/NAME.mp4",
            _has_files,
            filmed=True,
        ),
    ),
    by_definition=True,
    masked=True,
)
