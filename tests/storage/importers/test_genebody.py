"""The genebody importer: poses by name and inverted, mattes, missing cameras, and sentences."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from tests.support import ring

NAMES = ("01", "13", "25")
FRAMES = {1: 0, 4: 1}
"""Instant of the ring by number in names."""


def cams(order: tuple[int, ...] = (2, 0, 1)) -> dict[str, dict[str, np.ndarray]]:
    """Written in another order than the folders'."""
    return {
        NAMES[v]: {"K": ring.intrinsics(v), "D": ring.DISTORTION, "c2w": np.linalg.inv(ring.pose(v))} for v in order
    }


def save(base: Path, content: Any) -> None:
    base.mkdir(parents=True, exist_ok=True)
    np.save(base / "annots.npy", content, allow_pickle=True)


def write(base: Path) -> None:
    save(base, {"cams": cams()})
    for v, name in enumerate(NAMES):
        for number, n in FRAMES.items():
            ring.write_picture(base / "image" / name / f"{number:04d}.jpg", v, n)
            ring.write_mask(base / "mask" / name / f"mask{number:04d}.png", v, n)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("genebody", base, options)


def test_cameras_pictures_and_masks_are_those_of_the_files(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), capture.frame_rate) == (NAMES, [1, 4], 15)
    ring.check_cameras(capture, (0, 1, 2))
    ring.check_pictures(capture, (0, 1, 2), FRAMES)
    ring.check_masks(capture, (0, 1, 2), FRAMES)


def test_the_paper_s_four_sources_are_a_protocol(base: Path) -> None:
    assert "protocol genebody_4 needs cameras that are not there: 37" in find(base).notes
    save(base, {"cams": {**cams(), "37": cams()["25"]}})
    shutil.copytree(base / "image" / "25", base / "image" / "37")
    shutil.copytree(base / "mask" / "25", base / "mask" / "37")
    assert find(base).splits["genebody_4"].sources == ("01", "13", "25", "37")


def test_cameras_that_are_missing_are_said(base: Path) -> None:
    save(base, {"cams": cams((0, 1))})
    assert "pictures of camera 25 have no calibration and are left out" in find(base).notes
    save(base, {"cams": cams()})
    shutil.rmtree(base / "image" / "13")
    capture = find(base)
    assert "camera 13 has no pictures and is left out" in capture.notes
    ring.check_cameras(capture, (0, 2))


def test_wrong_conventions_and_broken_files_get_a_sentence(base: Path) -> None:
    def each(key: str, of: Any) -> dict[str, Any]:
        return {"cams": {n: {**c, key: of(NAMES.index(n))} for n, c in cams().items()}}

    for content, said in (
        (each("c2w", ring.pose), "other direction"),
        (each("c2w", lambda v: np.linalg.inv(ring.pose(v)) * [[1, 1, 1, 1e3]] * 3), "camera 01"),
        (each("c2w", lambda v: np.linalg.inv(ring.pose(v)) * np.array([1, 1, 1, 0.01])), "m apart where"),
        (each("K", lambda v: np.diag([2.0, 2, 1]) @ ring.intrinsics(v)), "are for pictures of another size"),
        (each("c2w", lambda v: np.full((4, 4), 1e308)), "camera 01"),
        (each("K", lambda v: []), "camera 01: K has 0 numbers, expected 9"),
        ({"cams": {"01": {"K": 1}}}, "camera 01 has no D, c2w"),
        ({"cams": {"99": cams()["01"]}}, "names none of the cameras 01, 13, 25 of image"),
        ({"cams": []}, "holds no cams with a camera's K, D and c2w each"),
        ({}, "holds no cams"),
    ):
        save(base, content)
        with pytest.raises(UserError, match=said):
            find(base)
    save(base, {"cams": cams()})
    shutil.rmtree(base / "image")
    with pytest.raises(UserError, match=r"no pictures in .*image"):
        find(base)
