"""The actorshq importer: places and turns of cameras in the world, intrinsics in widths, blanks, partial downloads."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from tests.support import ring

NAMES = ("Cam001", "Cam002", "Cam010")
FRAMES = {0: 0, 7: 1}
"""Instant of the ring by number in names."""
HEAD = "name, w, h, rx, ry, rz, tx, ty, tz, fx, fy, px, py"
NONE = np.zeros(5)


def row(v: int, world_to_camera: np.ndarray | None = None, scale: float = 1.0, k: np.ndarray | None = None) -> str:
    """A camera's row; OpenCV turns the matrix into a vector here."""
    to_world = np.linalg.inv(ring.pose(v) if world_to_camera is None else world_to_camera)
    vector = cv2.Rodrigues(to_world[:3, :3])[0].ravel()
    k = ring.intrinsics(v) if k is None else k
    w, h = ring.SIZE
    values = [w, h, *vector, *(scale * to_world[:3, 3]), k[0, 0] / w, k[1, 1] / h, k[0, 2] / w, k[1, 2] / h]
    return ", ".join([NAMES[v], *(repr(float(x)) if i > 1 else str(x) for i, x in enumerate(values))])


def calibrate(base: Path, *rows: str) -> None:
    (base / "calibration.csv").write_text("\n".join([HEAD, *(rows or map(row, range(3)))]) + "\n")


def write(base: Path) -> None:
    for v, name in enumerate(NAMES):
        for number, n in FRAMES.items():
            ring.write_picture(base / "rgbs" / name / f"{name}_rgb{number:06d}.jpg", v, n)
            ring.write_mask(base / "masks" / name / f"{name}_mask{number:06d}.png", v, n)
    calibrate(base)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("actorshq", base, options)


def test_cameras_pictures_and_masks_are_those_of_the_files(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), capture.frame_rate) == (NAMES, [0, 7], 25)
    ring.check_cameras(capture, (0, 1, 2), NONE)
    ring.check_pictures(capture, (0, 1, 2), FRAMES)
    ring.check_masks(capture, (0, 1, 2), FRAMES)
    assert any("direction: camera to world; all cameras look at one point" in n for n in capture.notes)


def test_rows_go_by_name_and_what_is_missing_is_left_out(base: Path) -> None:
    calibrate(base, row(2), row(0), row(1))
    ring.check_cameras(find(base), (0, 1, 2), NONE)
    shutil.rmtree(base / "rgbs" / NAMES[1])
    assert "1 of 3 calibrated cameras have no pictures and are left out" in find(base).notes
    ring.check_cameras(find(base), (0, 2), NONE)
    calibrate(base, row(0))
    assert f"pictures of camera {NAMES[2]} have no calibration and are left out" in find(base).notes


def test_wrong_conventions_and_broken_files_get_a_sentence(base: Path) -> None:
    for rows, said in (
        ([row(v, np.linalg.inv(ring.pose(v))) for v in range(3)], "other direction"),
        ([row(v, scale=1000) for v in range(3)], r"m, at most 1000 m are plausible|m apart"),
        ([row(v, k=np.diag([64, 48, 1]) @ ring.intrinsics(v)) for v in range(3)], "for pictures of another size"),
        ([row(0).replace("Cam001, 64", "Cam001, sixty")], r"calibration.csv line 2: w is ' sixty'; a number"),
        ([row(0), row(0)], "line 3: camera Cam001 is there twice"),
        (["Cam001, 64"], "line 2: h is None; a number is expected"),
        (["Cam001, 64, 48, 9e9, 0, 0, 0, 0, 0, 1, 1, .5, .5"], "rotation vector has the length"),
        (["Cam001, 64, 48, nan, 0, 0, 0, 0, 0, 1, 1, .5, .5"], "rotation vector has the length nan"),
        (["other, 64, 48, 0, 0, 0, 0, 0, 0, 1, 1, .5, .5"], "names none of the cameras Cam001, Cam002, Cam010"),
    ):
        calibrate(base, *rows)
        with pytest.raises(UserError, match=said):
            find(base)
    (base / "calibration.csv").write_text("name,w\n")
    with pytest.raises(UserError, match="lacks the columns h, rx"):
        find(base)
    shutil.rmtree(base / "rgbs")
    calibrate(base)
    with pytest.raises(UserError, match="give the folder of one scale, such as Sequence1/4x"):
        find(base)
