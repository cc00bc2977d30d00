"""Metashape's cameras as XML: sensors with calibrations, cameras with poses, camera to world, OpenCV axes.

The principal point is counted from the middle of the picture, in pixels' corners. Of a sensor's calibrations the one of
class `adjusted` is meant. p1 and p2 are OpenCV's p2 and p1; b1 is added to fx, b2 is skew; k4 is another coefficient
than OpenCV's. The scale of a component's transform is metres in a unit of its cameras' places. Format: Metashape
manual, appendix D, and its export of cameras.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.calibration_format import Calibration, CalibrationFormat, Sized, begins, fixed
from posegaussian.storage.importers.cameras import RawCamera, numbers
from posegaussian.storage.model.documents import read_xml, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError

MOST_SKEW = 1e-6
"""Of b2 over f, above which it is no rounding."""


def read(path: Path) -> Calibration:
    """The cameras that have a pose. Raises CalibrationError."""
    try:
        root = read_xml(path, "calibration")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    sensors = {s.get("id", ""): s for s in root.iterfind("chunk/sensors/sensor")}
    scales = {
        c.get("id", ""): float(numbers([c.findtext("transform/scale")], "", f"{path}: scale", [(1,)])[0])
        for c in root.iterfind("chunk/components/component")
        if c.find("transform/scale") is not None
    }
    cameras: dict[str, Sized] = {}
    used = set()
    for camera in root.iter("camera"):
        name, pose = (camera.get("label") or "").rpartition("/")[2], camera.findtext("transform")
        if not name or pose is None:
            continue  # it was not aligned
        if name in cameras:
            raise CalibrationError(f"calibration {path}: two cameras are labelled {name}; rename one")
        sensor = sensors.get(camera.get("sensor_id", ""))
        if sensor is None:
            raise CalibrationError(f"calibration {path}: camera {name} has no sensor")
        used.add(camera.get("component_id", ""))
        cameras[name] = fixed(_camera(name, sensor, pose))
    if not cameras:
        raise CalibrationError(f"calibration {path} has no camera with a transform; align the cameras and export again")
    if len(used) > 1:
        raise CalibrationError(
            f"calibration {path}: its cameras are of {len(used)} components, whose places are not one another's; align"
            " them in one"
        )
    return Calibration(cameras, "camera to world", True, scales.get(used.pop()))


def _camera(name: str, sensor: ElementTree.Element, pose: str) -> RawCamera:
    found = sensor.findall("calibration")
    chosen = next((c for c in found if c.get("class") == "adjusted"), found[0] if found else None)
    if chosen is None:
        raise CalibrationError(f"camera {name}: its sensor has no calibration; optimise the cameras and export again")
    if (kind := sensor.get("type", "frame")) != "frame":
        raise CalibrationError(f"camera {name}: its sensor is of the type {shortened(kind)}; frame cameras are read")
    resolution = chosen.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    sides = [None if resolution is None else resolution.get(k) for k in ("width", "height")]
    width, height = numbers(sides, name, "resolution", [(2,)])
    if not (np.isfinite([width, height]).all() and 0 < width < 2**20 and 0 < height < 2**20):
        raise CalibrationError(f"camera {name}: resolution {width:g}x{height:g} px is none")
    value = {
        k: float(numbers([chosen.findtext(k) or 0], name, k, [(1,)])[0])
        for k in ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
    }
    if value["k4"] != 0 or not abs(value["b2"]) <= MOST_SKEW * abs(value["f"]):
        raise CalibrationError(
            f"camera {name}: k4 = {value['k4']:g} and b2 = {value['b2']:g} px have no place in OpenCV's model; optimise"
            " the cameras without k4 and b2 and export again"
        )
    to_world = numbers(pose.split(), name, "transform", [(4, 4)])
    rotation = to_world[:3, :3].T
    with np.errstate(over="ignore", invalid="ignore"):
        translation = -rotation @ to_world[:3, 3]
    return RawCamera(
        name,
        np.array(
            [
                [value["f"] + value["b1"], 0, width / 2 + value["cx"]],
                [0, value["f"], height / 2 + value["cy"]],
                [0, 0, 1],
            ]
        ),
        np.array([value["k1"], value["k2"], value["p2"], value["p1"], value["k3"]]),
        rotation,
        translation,
        (int(width), int(height)),
    )


FORMAT = CalibrationFormat("Metashape XML", lambda p: begins(p, (".xml",), "<sensors"), read)
