"""Vicon's .xcp for `import videos`: the direction that the cameras show, the sensor's middle, distorted to ideal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.errors import UserError
from tests.storage.importers.test_videos import NAMES, films, find
from tests.support import ring

SENSOR = np.array([80, 60])
CUT = (SENSOR - ring.SIZE) / 2
RADIAL = np.array([2e-5, 3e-10, 0.0])
"""Of distorted pixels to ideal ones; 1.3 px at the corner."""
CENTRE = np.array([1.5, -0.5])
"""Of the distortion, from the principal point."""


def quaternion(m: np.ndarray) -> np.ndarray:
    """X y z w of a rotation: the eigenvector of its own matrix to the largest eigenvalue (Bar-Itzhack 2000)."""
    (a, b, c), (d, e, f), (g, h, i) = m
    own = np.array(
        [[a - e - i, d + b, g + c, h - f], [d + b, e - a - i, h + f, c - g], [g + c, h + f, i - a - e, d - b],
         [h - f, c - g, d - b, a + e + i]]
    )  # fmt: skip
    return np.linalg.eigh(own)[1][:, -1]


def turned(v: int) -> np.ndarray:
    return quaternion(ring.rotation(v))


def text(x: np.ndarray) -> str:
    return " ".join(repr(float(n)) for n in np.ravel(x))


def write(
    base: Path,
    orientation: Callable[[int], np.ndarray] = turned,
    radial: np.ndarray | None = None,
    change: Callable[[str], str] = lambda t: t,
    count: int = 3,
) -> None:
    """Cameras whose pictures are the middle of their sensors, and one that is not calibrated."""
    cameras = []
    for v, name in enumerate(NAMES[:count]):
        k = ring.intrinsics(v)
        principal = k[:2, 2] + CUT
        lens = "" if radial is None else f'VICON_RADIAL2="Vicon3Parameter {text(principal + CENTRE)} {text(radial)}"'
        cameras.append(
            f'<Camera DEVICEID="{name}" SYSTEM="DV" SENSOR_SIZE="{SENSOR[0]} {SENSOR[1]}"'
            f' PIXEL_ASPECT_RATIO="{float(k[0, 0] / k[1, 1])!r}"><KeyFrames><KeyFrame FRAME="0"'
            f' FOCAL_LENGTH="{k[0, 0]}" ORIENTATION="{text(orientation(v))}" POSITION="{text(1000 * ring.centre(v))}"'
            f' PRINCIPAL_POINT="{text(principal)}" {lens}/></KeyFrames></Camera>'
        )
    whole = f'<?xml version="1.0"?><Cameras>{"".join(cameras)}<Camera DEVICEID="9"><KeyFrames/></Camera></Cameras>'
    (base / "rig.xcp").write_text(change(whole))


def distorted(base: Path) -> None:
    """The same with distortion."""
    write(base, radial=RADIAL)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    films(tmp_path)
    return tmp_path


@pytest.mark.parametrize("other", [False, True])
def test_the_direction_is_the_one_in_which_cameras_look_at_one_point(base: Path, other: bool) -> None:
    """The same rig from a file of either direction: the quaternion and its inverse."""
    write(base, (lambda v: turned(v) * [-1, -1, -1, 1]) if other else turned)
    capture = find_capture("auto", base, {})
    ring.check_cameras(capture, (0, 1, 2), np.zeros(5))
    direction = "camera to world" if other else "world to camera"
    assert "unit: 0.001 m, as the format has it" in capture.notes
    assert any(
        n.startswith(
            f"direction: {direction}, as quaternions read so let 3 cameras look at one point to 0 degrees, and"
        )
        for n in capture.notes
    )


def test_distorted_pixels_come_from_ideal_ones(base: Path) -> None:
    """What the file's own formula takes to an ideal pixel is where the imported camera sees that ray."""
    distorted(base)
    rig = find(base).rig
    for v in range(3):
        k = ring.intrinsics(v)
        for seen in ([0.0, 0.0], [63.0, 47.0], [40.0, 7.0]):
            offset = seen - k[:2, 2] - CENTRE
            r2 = offset @ offset
            ideal = k[:2, 2] + CENTRE + offset * (1 + RADIAL[0] * r2 + RADIAL[1] * r2**2)
            ray = np.linalg.inv(k) @ [*ideal, 1]
            assert np.abs(ideal - seen).max() > 0.02
            landed = ring.landing(rig.intrinsics[v], rig.distortion[v], np.eye(4), 2.5 * ray)
            np.testing.assert_allclose(landed, np.add(seen, 0.5), atol=0.02)


def test_what_the_cameras_do_not_show_is_refused(base: Path) -> None:
    def sideways(v: int) -> np.ndarray:
        return quaternion(np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]) @ ring.rotation(v))

    write(base, sideways)
    with pytest.raises(UserError, match=r"the cameras show it not: they look .* OpenCV's FileStorage with R and T"):
        find(base)
    write(base, lambda v: np.array([0, 0, 0, 1.0]))
    with pytest.raises(UserError, match="the cameras show it not"):
        find(base)
    write(base, count=1)
    with pytest.raises(UserError, match="has one camera, which does not show"):
        find(base)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('FOCAL_LENGTH="70.0"', 'FOCAL_LENGTH="x"', "camera cam0: FOCAL_LENGTH .* is not made of numbers"),
        ('FOCAL_LENGTH="70.0"', 'FOCAL_LENGTH="0"', "camera cam0: FOCAL_LENGTH 0 px cannot be"),
        ('SENSOR_SIZE="80 60"', 'SENSOR_SIZE="60 40"', "its video is 64x48 px, larger than its sensor of 60x40"),
        (
            'SENSOR_SIZE="80 60"',
            'SENSOR_SIZE="8000 6000"',
            "the principal point .* for pictures of another size",
        ),
        ('ORIENTATION="', 'ORIENTATION="9 ', "ORIENTATION has 5 numbers, expected 4"),
        ('POSITION="', 'POSITION="1e300 0 0" X="', r"POSITION \[1e\+300, 0.0, 0.0\] mm; at most"),
        ("Vicon3Parameter", "Other", "VICON_RADIAL2 is .*; Vicon3Parameter with a centre and three"),
        (" 2e-05 ", " -0.1 ", "OpenCV's model misses its distortion .* Undistort the videos"),
        ("<KeyFrame FRAME", "<Other FRAME", "has no camera with a KeyFrame"),
        ('DEVICEID="cam1"', 'DEVICEID="cam0"', "camera cam0 is there twice"),
        ("</Cameras>", "", "cannot be read"),
    ],
)
def test_broken_files_get_a_sentence(base: Path, old: str, new: str, said: str) -> None:
    def change(t: str) -> str:
        assert old in t
        return t.replace(old, new)

    write(base, radial=RADIAL, change=change)
    with pytest.raises(UserError, match=said):
        find(base)
