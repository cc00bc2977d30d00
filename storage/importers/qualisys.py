"""Qualisys' own calibration, a `*.qca.txt` that holds XML, as the same camera tables that a TOML calibration has.

Millimetres; `x, y, z` is the camera's place in the world. The rows r1., r2., r3. are the camera's axes in the world: x
to the right, y up, z backwards, as the camera looks along -z. Focal lengths and principal point are in 64ths of a pixel
of the sensor, pixel centres at integers: a sensor of 1088 columns ends at 64 x 1087. Distortion is OpenCV's k1 k2 k3
and p1 p2, of normalised coordinates, so it has no unit (Pose2Sim's converter divides it by 64, too). `fov_video` is the
part of the sensor that was filmed, its last row and column included.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.model.documents import read_xml
from posegaussian.storage.model.errors import CalibrationError, SourceError

SUBPIXELS = 64
"""Units of the file in a pixel."""

_BACKWARDS = np.diag([1.0, -1.0, -1.0])
"""From a camera that looks along -z with y up to one that looks along z with y down."""


def is_qualisys(path: Path) -> bool:
    """Whether a file's name says that Qualisys wrote it: QTM exports `*.qca.txt` and `*.qca`."""
    return path.name.lower().endswith((".qca.txt", ".qca"))


def qualisys_tables(path: Path) -> dict[str, Mapping[str, Any]]:
    """{serial: table} of the file's cameras, OpenCV axes, world to camera, metres; cameras that are off are marked
    `ignore`.

    Raises CalibrationError, naming file and camera, for what is no XML, is missing or is no number, for two cameras of
    one serial, and for pictures that QTM shows turned.
    """
    try:
        root = read_xml(path, "calibration")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    tables: dict[str, Mapping[str, Any]] = {}
    for at, camera in enumerate(root.iterfind("cameras/camera")):
        serial = camera.get("serial", "")
        if not serial or serial in tables:
            raise CalibrationError(
                f"calibration {path}: camera {at + 1} has the serial {serial!r}; each needs one of its own"
            )
        tables[serial] = _table(camera, f"calibration {path}, camera {serial}")
    if not tables:
        raise CalibrationError(f"calibration {path} holds no cameras/camera; export it from QTM as a .qca.txt file")
    return tables


def _table(camera: ElementTree.Element, where: str) -> dict[str, Any]:
    if (turned := camera.get("viewrotation", "0")) != "0":
        raise CalibrationError(
            f"{where}: viewrotation {turned} must be 0, or the pictures' axes are not the sensor's; set it to 0 in QTM"
            " and export calibration and videos again"
        )
    left, top, right, bottom = (_number(camera, "fov_video", k, where) for k in ("left", "top", "right", "bottom"))
    inner = {
        k: _number(camera, "intrinsic", k, where) / SUBPIXELS
        for k in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV", "skew")
    }
    names = (
        "radialDistortion1",
        "radialDistortion2",
        "tangentalDistortion1",
        "tangentalDistortion2",
        "radialDistortion3",
    )
    axes = np.array([[_number(camera, "transform", f"r{i}{j}", where) for j in (1, 2, 3)] for i in (1, 2, 3)])
    centre = np.array([_number(camera, "transform", k, where) for k in "xyz"]) / 1000
    rotation = _BACKWARDS @ axes
    return {
        "matrix": [
            [inner["focalLengthU"], inner["skew"], inner["centerPointU"] - left],
            [0.0, inner["focalLengthV"], inner["centerPointV"] - top],
            [0.0, 0.0, 1.0],
        ],
        "distortions": [_number(camera, "intrinsic", k, where) for k in names],
        "rotation": rotation.tolist(),
        "translation": (-rotation @ centre).tolist(),
        "size": [right - left + 1, bottom - top + 1],
        "ignore": camera.get("active", "1") == "0",
    }


def _number(camera: ElementTree.Element, part: str, key: str, where: str) -> float:
    found = camera.find(part)
    text = None if found is None else found.get(key)
    if text is None:
        raise CalibrationError(f"{where} has no {part} {key}; export the calibration from QTM again")
    try:
        return float(text)
    except ValueError:
        raise CalibrationError(
            f"{where}: {part} {key} {text!r} is not a number; export the calibration from QTM again"
        ) from None
