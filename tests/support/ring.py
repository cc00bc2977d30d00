"""A ring of cameras around a person's place, by hand, from which the tests of data sets write their files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from posegaussian.storage.model.capture import Capture
from posegaussian.storage.readers.sources import open_source
from tests.support.import_capture import project

SIZE = (64, 48)
"""(width, height) px."""
DISTANCE = 2.5
"""Metres from the cameras to the place they look at."""
PLACE = np.array([0.3, -1.1, 0.2])
"""That place, metres."""
POINT = PLACE + np.array([0.12, -0.2, 0.07])
"""The known point, metres."""
DISTORTION = np.array([-0.05, 0.1, 1e-3, -2e-3, 0.01])


def intrinsics(v: float) -> np.ndarray:
    """[3, 3] px, pixel centres at integers; every camera has its own."""
    return np.array([[70.0 + v, 0, 31.0 - 0.5 * v], [0, 71.0 + v, 24.5 + 0.25 * v], [0, 0, 1]])


def rotation(v: float) -> np.ndarray:
    """[3, 3] world to camera; y of the world is down, camera v stands 50 v + 20 degrees around the place and 20 v
    degrees above it."""
    around, above = np.radians(50 * v + 20), np.radians(20 * v)
    level = np.array([-np.sin(around), 0, -np.cos(around)])
    forward = np.cos(above) * level + [0, np.sin(above), 0]
    right = np.cross([0.0, 1, 0], level)
    return np.stack([right, np.cross(forward, right), forward])


def centre(v: float) -> np.ndarray:
    """[3] metres."""
    return PLACE - DISTANCE * rotation(v)[2]


def translation(v: float) -> np.ndarray:
    """[3] metres, world to camera."""
    return -rotation(v) @ centre(v)


def pose(v: float) -> np.ndarray:
    """[4, 4] world to camera, metres."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation(v), translation(v)
    return out


def seen(v: int, point: np.ndarray = POINT, distortion: np.ndarray = DISTORTION) -> np.ndarray:
    """(u, v) px of a point in a camera, pixel centres at integers."""
    return landing(intrinsics(v), distortion, pose(v), point)


def landing(k: np.ndarray, distortion: np.ndarray, m: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(u, v) px of a point in a camera of intrinsics [3, 3], distortion [5 or more] and pose [4, 4]."""
    x, y, z = m[:3, :3] @ point + m[:3, 3]
    beyond = distortion[4] * ((x * x + y * y) / z**2) ** 3 * np.array([k[0, 0] * x, k[1, 1] * y]) / z
    return project(k, distortion, m[:3, :3], m[:3, 3], point) + beyond


def level(v: int, n: int) -> int:
    """Grey of camera v's picture at instant n."""
    return 20 + 40 * v + 10 * n


def write_picture(path: Path, v: int, n: int, size: tuple[int, int] = SIZE) -> None:
    """A plain picture; JPEG keeps plain grey to a step or two."""
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((size[1], size[0], 3), level(v, n), np.uint8))


def mask(v: int, n: int, value: int = 255, size: tuple[int, int] = SIZE) -> np.ndarray:
    """[h, w] uint8, the subject in the rows from 10 + 3 v, the columns from 5 + n, each over 20 px."""
    out = np.zeros((size[1], size[0]), np.uint8)
    out[10 + 3 * v : 30 + 3 * v, 5 + n : 25 + n] = value
    return out


def write_mask(path: Path, v: int, n: int, value: int = 255) -> None:
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), mask(v, n, value))


def check_cameras(capture: Capture, order: Sequence[int], distortion: np.ndarray = DISTORTION) -> None:
    """View i is camera order[i] of the ring, to 1e-6."""
    rig = capture.rig
    for i, v in enumerate(order):
        np.testing.assert_allclose(rig.world_to_camera[i], pose(v), atol=1e-6)
        own = rig.world_to_camera[i]
        k5 = rig.distortion[i]
        x, y, z = own[:3, :3] @ POINT + own[:3, 3]
        beyond = (
            k5[4] * ((x * x + y * y) / z**2) ** 3 * np.array([rig.intrinsics[i, 0, 0] * x, rig.intrinsics[i, 1, 1] * y])
        )
        landed = project(rig.intrinsics[i], k5, own[:3, :3], own[:3, 3], POINT) + beyond / z
        np.testing.assert_allclose(landed, seen(v, POINT, distortion) + 0.5, atol=1e-6)


def check_pictures(capture: Capture, order: Sequence[int], instants: Mapping[int, int]) -> None:
    """Picture n of view i is that of camera order[i] at instant instants[n]."""
    source = open_source(capture, "pictures")
    for i, v in enumerate(order):
        for n, picture in zip(instants, source.read(i, list(instants)), strict=True):
            assert abs(int(picture[20, 20, 0]) - level(v, instants[n])) <= 2, (capture.rig.names[i], n)


def check_masks(capture: Capture, order: Sequence[int], instants: Mapping[int, int]) -> None:
    """The same of masks."""
    source = open_source(capture, "masks")
    for i, v in enumerate(order):
        for n, found in zip(instants, source.read(i, list(instants)), strict=True):
            np.testing.assert_array_equal(found > 127, mask(v, instants[n]) > 0, err_msg=f"{capture.rig.names[i]}, {n}")
