"""Kalibr's `camchain.yaml`: `cam0`, `cam1`, ..., each placed by the one before it.

`T_cn_cnm1` [4, 4] takes points of camera n-1 to camera n, in the unit of the target, metres; the world is camera 0.
Pinhole cameras with radtan (k1 k2 p1 p2) or no distortion are OpenCV's. Format: https://github.com/ethz-asl/kalibr,
aslam_offline_calibration/kalibr/python/kalibr_common/ConfigReader.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.importers.calibration_format import Calibration, CalibrationFormat, begins, fixed
from posegaussian.storage.importers.cameras import RawCamera, numbers
from posegaussian.storage.importers.common import natural
from posegaussian.storage.model.documents import shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.model.yaml_documents import read_yaml

LARGEST = 1e12
"""Of a number in a matrix, beyond which products are not finite; plausible places are checked later."""


def read(path: Path) -> Calibration:
    """The cameras of a chain. Raises CalibrationError."""
    try:
        data = read_yaml(path, "calibration")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    names = sorted((n for n in data if str(n).startswith("cam")), key=natural) if isinstance(data, dict) else []
    if not names or not all(isinstance(data[n], dict) for n in names):
        raise CalibrationError(f"calibration {path} has no cameras cam0, cam1, ...")
    pose = np.eye(4)
    cameras = {}
    for at, name in enumerate(names):
        given = data[name]
        if at > 0:
            step = numbers(_of(given, "T_cn_cnm1", name, path), name, "T_cn_cnm1", [(4, 4)])
            if not (np.abs(step) < LARGEST).all():
                raise CalibrationError(f"camera {name}: T_cn_cnm1 holds {np.abs(step).max():g}; it must be a pose")
            pose = step @ pose
            if not (np.abs(pose) < LARGEST).all():
                raise CalibrationError(f"camera {name}: the chain leads {np.abs(pose).max():g} m away")
        cameras[name] = fixed(_camera(name, given, pose, path))
    return Calibration(cameras, "world to camera, each from the one before", False, 1.0)


def _of(given: dict[str, Any], key: str, name: str, path: Path) -> Any:
    if key not in given:
        raise CalibrationError(f"calibration {path}: camera {name} has no {key}")
    return given[key]


def _camera(name: str, given: dict[str, Any], pose: np.ndarray, path: Path) -> RawCamera:
    model, lens = _of(given, "camera_model", name, path), given.get("distortion_model", "none")
    if model != "pinhole" or lens not in ("radtan", "none"):
        raise CalibrationError(
            f"camera {name}: the model {shortened(model)} with {shortened(lens)} is not read; calibrate with"
            " pinhole-radtan"
        )
    fu, fv, pu, pv = numbers(_of(given, "intrinsics", name, path), name, "intrinsics", [(4,)])
    size = numbers(_of(given, "resolution", name, path), name, "resolution", [(2,)])
    if not np.isfinite(size).all():
        raise CalibrationError(f"camera {name}: resolution {size.tolist()} must be two whole numbers")
    return RawCamera(
        name,
        np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]]),
        np.zeros(4) if lens == "none" else numbers(given.get("distortion_coeffs"), name, "distortion_coeffs", [(4,)]),
        pose[:3, :3].copy(),
        pose[:3, 3].copy(),
        (int(size[0]), int(size[1])),
    )


FORMAT = CalibrationFormat("Kalibr camchain.yaml", lambda p: begins(p, (".yaml", ".yml"), "camera_model:", 2**20), read)
