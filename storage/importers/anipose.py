"""TOML calibrations of anipose and FreeMoCap: tables of cameras, world to camera, in the unit of their board.

The tables are those of `toml_cameras.py`. FreeMoCap's board, and so its file, is in millimetres, anipose's in whatever
its user measured it in, and no file says which: how far cameras lie apart does. Pixel centres lie at integers.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.calibration_format import Calibration, CalibrationFormat, begins, fixed
from posegaussian.storage.importers.cameras import RawCamera, raw_centre
from posegaussian.storage.importers.toml_cameras import table_camera, toml_tables
from posegaussian.storage.model.cameras import distances
from posegaussian.storage.model.errors import CalibrationError
from posegaussian.storage.model.plausible import APART

MILLIMETRE = 1e-3


def read(path: Path) -> Calibration:
    """The cameras of a file, but those marked `ignore`. Raises CalibrationError."""
    cameras: dict[str, RawCamera] = {}
    for key, table in toml_tables(path).items():
        name = str(table.get("name") or key.rpartition(".")[2])
        if name in cameras:
            raise CalibrationError(f"calibration {path}: two cameras are named {name}; rename one")
        if not table.get("ignore"):
            cameras[name] = table_camera(name, table)
    if not cameras:
        raise CalibrationError(
            f"calibration {path} has no camera with matrix, rotation and translation that is not set to ignore"
        )
    apart = _apart(cameras.values())
    in_millimetres = APART[0] <= apart * MILLIMETRE <= APART[1]
    return Calibration(
        {n: fixed(c) for n, c in cameras.items()},
        "world to camera",
        False,
        MILLIMETRE if in_millimetres else None,
        f"as cameras lie up to {apart:.4g} units apart, which are millimetres; the option scale overrules it",
    )


def _apart(cameras: Iterable[RawCamera]) -> float:
    """The largest distance of two cameras, in the file's unit; 0 of one camera."""
    found = distances(np.array([raw_centre(c) for c in cameras]))
    return float(found[-1]) if len(found) else 0.0


def _in_metres(path: Path) -> bool:
    """Whether a file may be in metres, as Pose2Sim and Caliscope have it, or cannot be read: those layouts bring joints
    and times along."""
    try:
        return _apart(camera((1, 1)) for camera in read(path).cameras.values()) <= APART[1]
    except CalibrationError:
        return True


FORMAT = CalibrationFormat(
    "anipose or FreeMoCap TOML", lambda p: begins(p, (".toml",), "matrix", 2**20), read, left=_in_metres
)
