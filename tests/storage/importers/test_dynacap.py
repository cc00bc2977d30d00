"""The dynacap importer: Skeletool's text in millimetres, films by camera, and sentences."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.support import ring
from tests.support.video_clips import counted, counting_clip

CAMERAS = {"0": 0, "2": 1, "10": 2}
"""Camera of the ring by name."""
FRAMES = 3


def line(key: str, matrix: np.ndarray) -> str:
    return f"  {key} {' '.join(repr(float(x)) for x in matrix.ravel())}\n"


def calibration(base: Path, change: Callable[[str], str] = lambda t: t, inverted: bool = False) -> None:
    text = "Skeletool Camera Calibration File V1.0\n"
    for name, v in CAMERAS.items():
        intrinsics, pose = np.eye(4), np.linalg.inv(ring.pose(v)) if inverted else ring.pose(v)
        intrinsics[:3, :3] = ring.intrinsics(v)
        pose[:3, 3] *= 1000
        text += f"name {name}\n  sensor 14.1864 10.3776\n  size {ring.SIZE[0]} {ring.SIZE[1]}\n  animated 0\n"
        text += f"{line('intrinsic', intrinsics)}{line('extrinsic', pose)}  radial 0\n"
    (base / "cameras.calibration").write_text(change(text))


def write(base: Path) -> None:
    (base / "training" / "img").mkdir(parents=True)
    for name in CAMERAS:
        counting_clip(base / "training" / "img" / f"c_{int(name):02d}.avi", FRAMES, ring.SIZE, codec="mpeg4")
    calibration(base)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("dynacap", base, options)


def test_cameras_and_pictures(base: Path) -> None:
    capture = find_capture("auto", base, {})
    assert capture.rig.names == ("00", "02", "10")
    ring.check_cameras(capture, (0, 1, 2), np.zeros(5))
    assert [counted(p) for p in open_source(capture, "pictures").read(2, [0, 2])] == [0, 2]
    for part in ("layout: dynacap", "unit: millimetres, as the layout has it", "direction: world to camera; all"):
        assert any(n.startswith(part) for n in capture.notes), part


def test_what_is_left_out_is_said(base: Path) -> None:
    (base / "training" / "img" / "c_02.avi").rename(base / "training" / "img" / "c_07.avi")
    (base / "training" / "fg").mkdir()
    capture = find(base)
    assert capture.rig.names == ("00", "10")
    assert {
        "video of camera 07 has no calibration and is left out",
        "cameras without a video are left out: 02",
        "training/fg, films before green, is not read as masks",
    } < {*capture.notes}


def test_wrong_conventions_and_broken_files_get_a_sentence(base: Path) -> None:
    calibration(base, inverted=True)
    with pytest.raises(UserError, match="the poses were written in the other direction"):
        find(base)
    for change, said in (
        (lambda t: t.replace("V1.0", "V2.0"), "does not begin with 'Skeletool Camera Calibration File V1.0'"),
        (lambda t: t.replace("name 2\n", "name 0\n"), "camera '00' needs a name of its own"),
        (lambda t: t.replace("name 0\n", ""), "'sensor' stands before the first name"),
        (lambda t: t.replace("radial 0", "radial 0.1", 1), r"camera 00: radial is \[0.1\], 0 is expected"),
        (lambda t: t.replace("animated 0", "animated 1", 1), "a camera that moves is not read"),
        (lambda t: t.replace("size 64 48", "size 128 96"), "camera 00: .* are for pictures of another size"),
        (lambda t: t.replace("  size 64 48\n", "", 1), "camera 00: cameras.calibration has no size"),
        (lambda t: t.replace("intrinsic 70.0", "intrinsic x", 1), "camera 00: intrinsic .* is not made of numbers"),
        (lambda t: t.replace("intrinsic 70.0", "intrinsic", 1), "intrinsic has 15 numbers, expected 16"),
        (lambda t: t.split("\n", maxsplit=1)[0], "has no cameras"),
    ):
        calibration(base, change)
        with pytest.raises(UserError, match=said):
            find(base)
    far = repr(float(ring.pose(0)[2, 3] * 1000))
    calibration(base, lambda t: t.replace(far, "2e9", 1))
    with pytest.raises(UserError, match="is it in millimetres"):
        find(base)
