"""CMU Panoptic: the HD cameras of its dome.

`calibration_NAME.json` lists cameras of all kinds with K, distCoef, R and t, world to camera, centimetres. HD cameras
`00_XX` have `hdVideos/hd_00_XX.mp4` or `hdImgs/00_XX/00_XX_00000000.jpg`, at 29.97 frames/s; VGA cameras and Kinects
run at other rates, so that their frame n is another instant, and are left out. Joints in space are not read. Format:
https://github.com/CMU-Perceptual-Computing-Lab/panoptic-toolbox.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.importers.cameras import RawCamera, numbers
from posegaussian.storage.importers.common import ImportOptions, folder, numbered, subfolders, videos_in
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.filmed import DataSet, Filmed, capture_of
from posegaussian.storage.importers.posed_pictures import Files
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.documents import read_json, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.images import PICTURE_SUFFIXES

PANOPTIC = DataSet("panoptic", 29.97, "centimetres", "world to camera", rate_told=True)
METRES = 1e-2
"""In a unit of the files."""
MOST_SKEW = 0.5
"""Px by which a matrix's skew may move the edge of a picture and be left out."""


class PanopticOptions(ImportOptions):
    """The layout leaves nothing else to choose."""


def find(source: Path, options: PanopticOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    path = _calibration(base)
    found = _filmed_files(base)
    if not found:
        raise SourceError(
            f"no pictures of HD cameras in {base}: expected hdVideos/hd_00_00.mp4 or hdImgs/00_00/00_00_00000000.jpg"
        )
    cameras, notes = _cameras(path, found)
    filmed = [Filmed(cameras[n], files) for n, files in found.items() if n in cameras]
    if not filmed:
        raise CalibrationError(f"{path} has none of the HD cameras {', '.join(list(found)[:6])}")
    return capture_of(PANOPTIC, filmed, options, notes=notes)


def _calibration(base: Path) -> Path:
    paths = sorted(base.glob("calibration_*.json"))
    if len(paths) != 1:
        raise CalibrationError(
            f"{base} holds {len(paths)} files calibration_NAME.json; give the folder of one sequence, which has one"
        )
    return paths[0]


def _filmed_files(base: Path) -> dict[str, Files]:
    """{camera: its pictures or video}."""
    images = {f.name: n for f in subfolders(base / "hdImgs") if (n := numbered(f, PICTURE_SUFFIXES))}
    return dict(images) or {n.removeprefix("hd_"): p for n, p in videos_in(base / "hdVideos").items()}


def _cameras(path: Path, wanted: dict[str, Files]) -> tuple[dict[str, RawCamera], list[str]]:
    """({name: HD camera that has pictures}, notes)."""
    try:
        data = read_json(path, "calibration")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    listed = data.get("cameras") if isinstance(data, dict) else None
    if not isinstance(listed, list) or not all(isinstance(c, dict) for c in listed):
        raise CalibrationError(f"{path} has no list of cameras")
    out: dict[str, RawCamera] = {}
    notes = []
    without = 0
    for given in listed:
        name = given.get("name")
        if given.get("type") != "hd" or not isinstance(name, str):
            continue
        if name in out:
            raise CalibrationError(f"{path}: camera {name} is there twice")
        if name not in wanted:
            without += 1
            continue
        camera = _camera(name, given, path)
        moved = abs(camera.intrinsics[0, 1] / camera.intrinsics[1, 1]) * max(camera.size or (0, 0)) / 2
        if moved > MOST_SKEW:
            notes.append(
                f"camera {name} is left out: its skew {camera.intrinsics[0, 1]:g} px would move the picture's edge by"
                f" {moved:.1f} px"
            )
            continue
        camera.intrinsics[0, 1] = 0
        out[name] = camera
    others = sum(c.get("type") != "hd" for c in listed)
    if others:
        notes.append(f"{others} cameras of other kinds run at other rates and are left out")
    if without:
        notes.append(f"{without} HD cameras have no pictures and are left out")
    uncalibrated = [n for n in wanted if n not in [c.get("name") for c in listed]]
    return out, notes + [f"pictures of camera {n} have no calibration and are left out" for n in uncalibrated]


def _camera(name: str, given: dict[str, Any], path: Path) -> RawCamera:
    if lacking := [k for k in ("K", "distCoef", "R", "t", "resolution") if k not in given]:
        raise CalibrationError(f"{path}: camera {name} has no {', '.join(lacking)}")
    size = given["resolution"]
    if not isinstance(size, list) or len(size) != 2 or not all(type(n) is int for n in size):
        raise CalibrationError(f"camera {name}: resolution {shortened(size)} is not [width, height] px")
    intrinsics = numbers(given["K"], name, "K", [(3, 3)])
    if not np.isfinite(intrinsics).all() or intrinsics[1, 1] == 0:
        raise CalibrationError(f"camera {name}: K {intrinsics.tolist()} is no matrix of intrinsics")
    return RawCamera(
        name,
        intrinsics,
        numbers(given["distCoef"], name, "distCoef", [(-1,)]),
        numbers(given["R"], name, "R", [(3, 3)]),
        numbers(given["t"], name, "t", [(3,)]) * METRES,
        (size[0], size[1]),
    )


IMPORTER = Importer(
    "panoptic",
    "calibration_NAME.json and hdVideos or hdImgs of one sequence, as CMU Panoptic has them.",
    PanopticOptions,
    find,
    (
        Trait("calibration_NAME.json", lambda base: any(base.glob("calibration_*.json"))),
        Trait("hdVideos/hd_00_00.mp4 or hdImgs/00_00", lambda base: or_broken(lambda: _filmed_files(base))),
    ),
)
