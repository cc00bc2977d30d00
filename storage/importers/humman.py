"""HuMMan-Recon: ten colour cameras around a person, pictures of one take.

`cameras.json` names cameras `kinect_color_000` and `kinect_depth_000` with K, R and T, world to camera, metres; the
world is that of the first colour camera, so its y axis is not gravity's. `kinect_color/kinect_000/000000.png` are
pictures, numbered in thirtieths of a second, every sixth is there; `kinect_mask` are soft mattes, `kinect_mask_manual`
those of the test split. Depth is of other cameras with other intrinsics, and meshes and body models are other
estimates: none is read. Format: https://github.com/MotrixLab/humman_toolbox, humman_recon.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from posegaussian.storage.importers.cameras import DISTORTION, RawCamera, numbers
from posegaussian.storage.importers.common import ImportOptions, folder, numbered, subfolders
from posegaussian.storage.importers.declaration import Importer, Trait
from posegaussian.storage.importers.filmed import DataSet, Filmed, capture_of
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.documents import read_json
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.images import PICTURE_SUFFIXES

HUMMAN = DataSet("humman", 30.0, "metres", "world to camera", rate_told=True)
CAMERAS = "cameras.json"
PICTURES = "kinect_color"
MASKS = ("kinect_mask_manual", "kinect_mask")


class HummanOptions(ImportOptions):
    """What to take where several fit."""

    masks: Literal["auto", "kinect_mask", "kinect_mask_manual", "none"] = Field(
        "auto", description="Folder of the masks; auto takes those made by hand where they are there."
    )


def find(source: Path, options: HummanOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    cameras = _cameras(base / CAMERAS)
    found = {f.name: n for f in subfolders(base / PICTURES) if (n := numbered(f, PICTURE_SUFFIXES))}
    if not found:
        raise SourceError(f"no pictures in {base / PICTURES}; expected {PICTURES}/kinect_000/000000.png")
    wanted = MASKS if options.masks == "auto" else (options.masks,)
    root = next((base / m for m in wanted if (base / m).is_dir()), None)
    if root is None and options.masks not in ("auto", "none"):
        raise SourceError(f"option masks: there is no folder {base / options.masks}")
    filmed = []
    for name, files in found.items():
        if name not in cameras:
            raise CalibrationError(
                f"pictures {base / PICTURES / name} have no camera {name.replace('kinect', PICTURES)} in"
                f" {base / CAMERAS}, which names {', '.join(list(cameras)[:10]) or 'none'}"
            )
        filmed.append(Filmed(cameras[name], files, numbered(root / name, PICTURE_SUFFIXES) if root else {}))
    notes = [f"camera {n} has no pictures and is left out" for n in cameras if n not in found]
    if root is not None:
        notes.append(f"masks: {root.name}")
    return capture_of(HUMMAN, filmed, options, notes=[*notes, "frames are numbered in thirtieths of a second"])


def _cameras(path: Path) -> dict[str, RawCamera]:
    """{kinect_000: its colour camera}."""
    try:
        data = read_json(path, "cameras")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    if not isinstance(data, dict):
        raise CalibrationError(f"{path} holds no cameras; an object of kinect_color_000, ... is expected")
    out = {}
    for key, value in data.items():
        if not key.startswith(PICTURES):
            continue
        name = key.replace(PICTURES, "kinect", 1)
        lacking = [k for k in "KRT" if not isinstance(value, dict) or k not in value]
        if lacking:
            raise CalibrationError(f"{path}: camera {key} has no {', '.join(lacking)}")
        out[name] = RawCamera(
            name,
            numbers(value["K"], name, "K", [(3, 3)]),
            np.zeros(DISTORTION),
            numbers(value["R"], name, "R", [(3, 3)]),
            numbers(value["T"], name, "T", [(3,)]),
            None,
        )
    return out


IMPORTER = Importer(
    "humman",
    "cameras.json, kinect_color and kinect_mask of one take, as HuMMan-Recon has them.",
    HummanOptions,
    find,
    (
        Trait(CAMERAS, lambda base: (base / CAMERAS).is_file()),
        Trait("kinect_color/kinect_000", lambda base: bool(subfolders(base / PICTURES)), filmed=True),
    ),
)
