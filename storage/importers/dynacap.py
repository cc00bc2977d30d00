"""Captures of DynaCap (and DeepCap, Neural Actor): `cameras.calibration` and a video a camera, `training/img/c_00.avi`.

The calibration is a text, "Skeletool Camera Calibration File V1.0": a block of lines a camera, matrices of 16 numbers
row by row, world to camera, millimetres, pixel centres at integers. `training/fg` holds the same films with what is
not the person green; they are not read. Format: EasyVolcap, scripts/dynacap/dynacap_to_easymocap.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.cameras import RawCamera, numbers, whole_size
from posegaussian.storage.importers.common import ImportOptions, folder, videos_in
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.filmed import DataSet, Filmed, capture_of
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.documents import read_text, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError

DYNACAP = DataSet("dynacap", 25.0, "millimetres", "world to camera")
METRES = 1e-3
"""In a unit of the files."""
HEAD = "Skeletool Camera Calibration File V1.0"
LARGEST = 2**20
"""Bytes of a calibration; one of 100 cameras has about 60,000."""
CALIBRATION, VIDEOS = "cameras.calibration", Path("training") / "img"


class DynaCapOptions(ImportOptions):
    """The layout leaves nothing else to choose."""


def find(source: Path, options: DynaCapOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    blocks = _blocks(base / CALIBRATION)
    videos = _videos(base)
    if not videos:
        raise SourceError(f"no videos in {base / VIDEOS}: expected c_00.avi, c_01.avi, ...")
    known = [n for n in videos if n in blocks]
    if not known:
        raise CalibrationError(
            f"{base / CALIBRATION} has none of the cameras {', '.join(list(videos)[:6])}; it has"
            f" {', '.join(list(blocks)[:6])}"
        )
    notes = [f"video of camera {n} has no calibration and is left out" for n in videos if n not in blocks]
    if without := [n for n in blocks if n not in videos]:
        notes.append(f"cameras without a video are left out: {', '.join(without)}")
    if (base / "training" / "fg").is_dir():
        notes.append("training/fg, films before green, is not read as masks")
    return capture_of(DYNACAP, [Filmed(_camera(n, blocks[n]), videos[n]) for n in known], options, notes=notes)


def _videos(base: Path) -> dict[str, Path]:
    """{camera: its video}; cameras are named by the two digits of c_00.avi."""
    return {n.removeprefix("c_"): p for n, p in videos_in(base / VIDEOS).items()}


def _blocks(path: Path) -> dict[str, dict[str, list[str]]]:
    """{camera: {key: its values}}. Raises CalibrationError for what is no such file."""
    try:
        lines = [line.split() for line in read_text(path, "calibration", LARGEST).split("\n") if line.strip()]
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    if not lines or " ".join(lines[0]) != HEAD:
        raise CalibrationError(f"calibration {path} does not begin with {HEAD!r}")
    out: dict[str, dict[str, list[str]]] = {}
    name = ""
    for key, *values in lines[1:]:
        if key == "name":
            name = " ".join(values).zfill(2)
            if not values or name in out:
                raise CalibrationError(f"calibration {path}: camera {shortened(name)} needs a name of its own")
            out[name] = {}
        elif not name:
            raise CalibrationError(f"calibration {path}: {shortened(key)} stands before the first name")
        else:
            out[name][key] = values
    if not out:
        raise CalibrationError(f"calibration {path} has no cameras")
    return out


def _camera(name: str, given: Mapping[str, list[str]]) -> RawCamera:
    if lacking := [k for k in ("size", "intrinsic", "extrinsic") if k not in given]:
        raise CalibrationError(f"camera {name}: {CALIBRATION} has no {', '.join(lacking)}")
    for key, why in (
        ("animated", "a camera that moves is not read"),
        ("radial", "what this coefficient means is not documented, so undistort the videos and set it to 0"),
    ):
        if np.any(value := numbers(given.get(key, ["0"]), name, key, [(-1,)])):
            raise CalibrationError(f"camera {name}: {key} is {value.tolist()}, 0 is expected; {why}")
    pose = numbers(given["extrinsic"], name, "extrinsic", [(4, 4)])
    intrinsics, size = numbers(given["intrinsic"], name, "intrinsic", [(4, 4)])[:3, :3], whole_size(given["size"], name)
    return RawCamera(
        name,
        intrinsics,
        np.zeros(5),
        pose[:3, :3],
        pose[:3, 3] * METRES,
        size,
    )


def _has_calibration(base: Path) -> bool:
    return (base / CALIBRATION).is_file()


IMPORTER = Importer(
    "dynacap",
    "cameras.calibration and training/img with a video a camera, as DynaCap has them.",
    DynaCapOptions,
    find,
    (
        Trait(CALIBRATION, _has_calibration),
        Trait("training/img/c_00.avi", lambda base: or_broken(lambda: _videos(base)), filmed=True),
    ),
)
