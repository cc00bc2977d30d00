"""The humman importer: world to camera, soft mattes, frames that are multiples of six, and sentences."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture, ring

FRAMES = {0: 0, 6: 1, 12: 2}
"""Instant of the ring by number in names."""
NAMES = ("kinect_000", "kinect_002", "kinect_010")
NONE = np.zeros(5)


def camera(v: int) -> dict[str, Any]:
    return {
        "K": ring.intrinsics(v).tolist(),
        "R": ring.rotation(v).tolist(),
        "T": ring.translation(v).tolist(),
    }


def cameras() -> dict[str, Any]:
    colour = {n.replace("kinect", "kinect_color"): camera(v) for v, n in enumerate(NAMES)}
    return {**colour, **{k.replace("color", "depth"): {"K": [], "R": [], "T": []} for k in colour}}


def write(base: Path) -> None:
    import_capture.dump(base / "cameras.json", cameras())
    for v, name in enumerate(NAMES):
        for number, n in FRAMES.items():
            ring.write_picture(base / "kinect_color" / name / f"{number:06d}.png", v, n)
            ring.write_mask(base / "kinect_mask" / name / f"{number:06d}.png", v, n, 200)
        (base / "kinect_depth" / name).mkdir(parents=True)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("humman", base, options)


def test_cameras_pictures_and_masks_are_those_of_the_files(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), capture.frame_rate) == (NAMES, [0, 6, 12], 30)
    ring.check_cameras(capture, (0, 1, 2), NONE)
    ring.check_pictures(capture, (0, 1, 2), FRAMES)
    ring.check_masks(capture, (0, 1, 2), FRAMES)
    assert {*np.unique(next(iter(open_source(capture, "masks").read(0, [0]))))} == {0, 255}  # nobody is a grey of 200
    for name in NAMES:
        for number, n in FRAMES.items():
            ring.write_mask(base / "kinect_mask_manual" / name / f"{number:06d}.png", 0, n)
    assert "masks: kinect_mask_manual" in find(base).notes
    assert "masks: kinect_mask" in find(base, masks="kinect_mask").notes
    assert find(base, masks="none").masks == ()


def test_wrong_conventions_and_broken_files_get_a_sentence(base: Path) -> None:
    def each(**change: Any) -> dict[str, Any]:
        return {
            n.replace("kinect", "kinect_color"): {**camera(v), **{k: of(v) for k, of in change.items()}}
            for v, n in enumerate(NAMES)
        }

    inverse = {v: np.linalg.inv(ring.pose(v)) for v in range(3)}
    for content, said in (
        (each(R=lambda v: inverse[v][:3, :3].tolist(), T=lambda v: inverse[v][:3, 3].tolist()), "other direction"),
        (each(T=lambda v: (1000 * ring.translation(v)).tolist()), r"m, at most 1000 m are plausible|m apart"),
        (each(K=lambda v: (np.diag([2, 2, 1]) @ ring.intrinsics(v)).tolist()), "are for pictures of another size"),
        (each(R=lambda v: "x"), "camera kinect_000: R 'x' is not made of numbers"),
        ({"kinect_color_000": {"K": []}}, "camera kinect_color_000 has no R, T"),
        ({}, "have no camera kinect_color_000 in"),
        ([], "holds no cameras"),
    ):
        import_capture.dump(base / "cameras.json", content)
        with pytest.raises(UserError, match=said):
            find(base)
    write_again = cameras()
    import_capture.dump(base / "cameras.json", write_again)
    shutil.rmtree(base / "kinect_mask" / NAMES[1])
    with pytest.raises(UserError, match="cameras kinect_002 have no masks while others have"):
        find(base)
    with pytest.raises(UserError, match="option masks: there is no folder"):
        find(base, masks="kinect_mask_manual")
    shutil.rmtree(base / "kinect_color")
    with pytest.raises(UserError, match=r"no pictures in .*kinect_color"):
        find(base)
