"""Vicon's calibrations `.xcp`: XML, millimetres, a quaternion x y z w and a camera's place. Cameras are named by their
DEVICEID.

Whether the quaternion turns the world to the camera or back is not documented, and public readers disagree: the reading
is taken with which the file's cameras look at one point. The radial coefficients take distorted pixels to ideal ones,
about a centre of their own and in powers of a pixel; OpenCV's that do the reverse are fitted. Pixels are those of the
sensor, of which a video may be the middle. Pixel centres are taken as integers.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from posegaussian.storage.importers.calibration_format import Calibration, CalibrationFormat, begins
from posegaussian.storage.importers.cameras import RawCamera, check_principal_point, numbers
from posegaussian.storage.importers.evidence import TOWARDS, off_axis
from posegaussian.storage.model.documents import read_xml, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError

FARTHEST = 1e6
"""Millimetres from the origin at which a camera may stand."""
MOST_OFF = 0.3
"""Px by which OpenCV's model may miss the file's distortion anywhere in the picture."""
GRID = 25
"""Pixels a side at which the two are compared."""


class Device(NamedTuple):
    """One calibrated camera as the file has it."""

    name: str
    focal: tuple[float, float]
    """(fx, fy) px."""
    principal: np.ndarray
    """[2] px of the sensor."""
    sensor: np.ndarray
    """[2] width and height px."""
    turn: np.ndarray
    """[3, 3] of the quaternion."""
    place: np.ndarray
    """[3] millimetres."""
    radial: tuple[np.ndarray, np.ndarray]
    """([2] centre in px of the sensor, [3] coefficients of distorted to ideal, px^-2, px^-4, px^-6)."""


def read(path: Path) -> Calibration:
    """The cameras that are calibrated, video and optical ones. Raises CalibrationError."""
    try:
        root = read_xml(path, "calibration")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    devices: dict[str, Device] = {}
    for camera in root.iter("Camera"):
        frames = camera.findall("KeyFrames/KeyFrame")
        if not frames:
            continue  # it was not calibrated
        device = _device(camera, next((f for f in frames if f.get("FRAME") == "0"), frames[0]), path)
        if device.name in devices:
            raise CalibrationError(f"calibration {path}: camera {device.name} is there twice")
        devices[device.name] = device
    if not devices:
        raise CalibrationError(f"calibration {path} has no camera with a KeyFrame; calibrate and save it again")
    to_camera, told = _direction(list(devices.values()), path)
    cameras = {n: partial(_camera, d, d.turn if to_camera else d.turn.T) for n, d in devices.items()}
    return Calibration(cameras, told, False, 1e-3, "as the format has it")


def _device(camera: ElementTree.Element, frame: ElementTree.Element, path: Path) -> Device:
    name = camera.get("DEVICEID") or camera.get("USERID") or ""
    if not name:
        raise CalibrationError(f"calibration {path}: a camera has no DEVICEID")

    def of(element: ElementTree.Element, key: str, count: int) -> np.ndarray:
        found = numbers((element.get(key) or "").split(), name, key, [(count,)])
        if not np.isfinite(found).all():
            raise CalibrationError(f"camera {name}: {key} {found.tolist()} must be finite")
        return found

    turn, place = of(frame, "ORIENTATION", 4), of(frame, "POSITION", 3)
    if not abs(np.linalg.norm(turn) - 1) < 1e-3:
        raise CalibrationError(f"camera {name}: ORIENTATION {turn.tolist()} is no quaternion of length 1")
    if not (np.abs(place) < FARTHEST).all():
        raise CalibrationError(f"camera {name}: POSITION {place.tolist()} mm; at most {FARTHEST:g} mm are plausible")
    aspect = float(of(camera, "PIXEL_ASPECT_RATIO", 1)[0]) if camera.get("PIXEL_ASPECT_RATIO") else 1.0
    if not 0.1 < aspect < 10:
        raise CalibrationError(f"camera {name}: PIXEL_ASPECT_RATIO {aspect:g} cannot be")
    focal, principal = float(of(frame, "FOCAL_LENGTH", 1)[0]), of(frame, "PRINCIPAL_POINT", 2)
    radial = _radial(name, frame, principal)
    return Device(name, (focal, focal / aspect), principal, of(camera, "SENSOR_SIZE", 2), _matrix(turn), place, radial)


def _radial(name: str, frame: ElementTree.Element, principal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(centre, coefficients) of VICON_RADIAL2, or of VICON_RADIAL, which older files have about the principal point."""
    words = (frame.get("VICON_RADIAL2") or "").split()
    if words:
        if words[0] != "Vicon3Parameter" or len(words) != 6:
            raise CalibrationError(
                f"camera {name}: VICON_RADIAL2 is {shortened(' '.join(words))}; Vicon3Parameter with a centre and three"
                " coefficients is read"
            )
        values = numbers(words[1:], name, "VICON_RADIAL2", [(5,)])
    else:
        old = numbers((frame.get("VICON_RADIAL") or "0 0").split(), name, "VICON_RADIAL", [(2,)])
        values = np.array([*principal, *old, 0.0])
    if not np.isfinite(values).all():
        raise CalibrationError(f"camera {name}: distortion {values.tolist()} must be finite")
    return values[:2], values[2:]


def _matrix(turn: np.ndarray) -> np.ndarray:
    """[3, 3] of a quaternion x y z w."""
    (x, y, z), w = turn[:3], turn[3]
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + (2 * w * across + 2 * across @ across) / float(turn @ turn))


def _direction(devices: Sequence[Device], path: Path) -> tuple[bool, str]:
    """(whether the quaternions turn the world to the cameras, the sentence on how that is known). Raises
    CalibrationError where cameras look at one point either way, or neither way."""
    turns, places = np.stack([d.turn for d in devices]), np.stack([d.place for d in devices])
    if len(devices) < 2:
        raise CalibrationError(
            f"calibration {path} has one camera, which does not show whether its quaternion turns the world to the"
            " camera or back; write it as OpenCV's FileStorage with R and T"
        )
    to_camera, to_world = off_axis(turns, places), off_axis(turns.transpose(0, 2, 1), places)
    if (to_camera <= TOWARDS) == (to_world <= TOWARDS):
        raise CalibrationError(
            f"calibration {path}: the format does not say whether its quaternions turn the world to the cameras or"
            f" back, and the cameras show it not: they look {to_camera:.0f} degrees past a common point one way and"
            f" {to_world:.0f} the other. Write it as OpenCV's FileStorage with R and T"
        )
    taken, other = sorted((to_camera, to_world))
    name = "world to camera" if to_camera <= TOWARDS else "camera to world"
    return to_camera <= TOWARDS, (
        f"{name}, as quaternions read so let {len(devices)} cameras look at one point to {taken:.0f} degrees, and"
        f" {other:.0f} the other way round"
    )


def _camera(device: Device, rotation: np.ndarray, size: tuple[int, int]) -> RawCamera:
    """The camera for a video of a size: the middle of the sensor. Raises CalibrationError."""
    cut = (device.sensor - size) / 2
    if not (cut >= 0).all():
        raise CalibrationError(
            f"camera {device.name}: its video is {size[0]}x{size[1]} px, larger than its sensor of"
            f" {device.sensor[0]:g}x{device.sensor[1]:g}; take the video as it was recorded"
        )
    centre, coefficients = device.radial
    k = np.array([[device.focal[0], 0, 0], [0, device.focal[1], 0], [0, 0, 1.0]])
    k[:2, 2] = device.principal - cut
    check_principal_point(f"camera {device.name}", k, None, size)
    if not (np.abs(device.focal) > 1e-3).all():
        raise CalibrationError(f"camera {device.name}: FOCAL_LENGTH {device.focal[0]:g} px cannot be")
    distortion = _distortion(device.name, k, centre - cut, coefficients, size)
    return RawCamera(device.name, k, distortion, rotation, -rotation @ device.place, None)


def _distortion(
    name: str, k: np.ndarray, centre: np.ndarray, coefficients: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """[5] OpenCV's k1 k2 p1 p2 k3 that take ideal pixels to those that the file's coefficients make them of.

    OpenCV's model is linear in them, so they are those of least squares over the picture. Raises CalibrationError where
    they miss.
    """
    if not coefficients.any():
        return np.zeros(5)
    rows, columns = np.meshgrid(*(np.linspace(0, n - 1, GRID) for n in size), indexing="ij")
    seen = np.stack([rows.ravel(), columns.ravel()], axis=1)
    with np.errstate(all="ignore"):
        from_centre = seen - centre
        r2 = (from_centre**2).sum(axis=1, keepdims=True)
        ideal = centre + from_centre * (1 + r2 * (coefficients[0] + r2 * (coefficients[1] + r2 * coefficients[2])))
        x, y = ((ideal - k[[0, 1], 2]) / k[[0, 1], [0, 1]]).T
        s = x * x + y * y
        model = np.stack(
            [
                np.stack([x * s, x * s**2, 2 * x * y, s + 2 * x * x, x * s**3], axis=1),
                np.stack([y * s, y * s**2, s + 2 * y * y, 2 * x * y, y * s**3], axis=1),
            ]
        ) * k[[0, 1], [0, 1]].reshape(2, 1, 1)
        moved = (seen - ideal).T
    if np.isfinite(model).all() and np.abs(model).max() < 1e12:
        found = np.linalg.lstsq(model.reshape(-1, 5), moved.ravel(), rcond=None)[0]
        off = float(np.abs(model @ found - moved).max())
    else:
        found, off = np.zeros(5), float("inf")
    if not off <= MOST_OFF:
        raise CalibrationError(
            f"camera {name}: OpenCV's model misses its distortion {coefficients.tolist()}, in powers of a pixel, by"
            f" {off:.2g} px, at most {MOST_OFF:g} are accepted. Undistort the videos, and write the file without"
        )
    return found


FORMAT = CalibrationFormat("Vicon .xcp", lambda p: begins(p, (".xcp",), "<Camera"), read)
