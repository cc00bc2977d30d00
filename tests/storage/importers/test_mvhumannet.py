"""The mvhumannet importer: intrinsics of twice the size, a unit of its own, the wrong camera, and sentences."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture, ring

SIZE = (512, 375)
"""An eighth of what the intrinsics are for."""
K = np.array([[4400.0, 0, 2047.5], [0, 4401.0, 1499.5], [0, 0, 1]])
NAMES = ("CC32871A004", "CC32871A023", "CC32871A041")
SCALE = 0.65
"""Metres in a unit of the translations."""
FRAMES = {5: 0, 10: 1}
"""Instant of the ring by number in names."""


def extrinsics(scale: float = SCALE, number: str = "41") -> dict[str, Any]:
    return {
        f"{n}_{NAMES[v]}.png": {
            "focal_length": [1, 1],
            "rotation": ring.rotation(v).tolist(),
            "translation": (ring.translation(v) / scale).tolist(),
        }
        for v, n in ((2, number), (0, "1"), (1, "10"))
    }


def write(base: Path) -> None:
    import_capture.dump(base / "camera_extrinsics.json", extrinsics())
    import_capture.dump(base / "camera_intrinsics.json", {"intrinsics": K.tolist(), "dist": []})
    (base / "camera_scale.pkl").write_bytes(pickle.dumps(SCALE, 4))
    for v, name in enumerate(NAMES):
        for number, n in FRAMES.items():
            ring.write_picture(base / "images" / name / f"{number:04d}_img.jpg", v, n, SIZE)
            mask = base / "fmask" / name / f"{number:04d}_img_fmask.png"
            mask.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(mask), ring.mask(v, n, 255, SIZE))


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("mvhumannet", base, options)


def test_a_point_lands_at_an_eighth_of_where_it_does_in_the_full_picture(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), len(pickle.dumps(SCALE, 4))) == (NAMES, [5, 10], 21)
    for v in range(3):
        np.testing.assert_allclose(capture.rig.world_to_camera[v], ring.pose(v), atol=1e-6)
        full = import_capture.project(K, np.zeros(4), ring.rotation(v), ring.translation(v), ring.POINT)
        m = capture.rig.world_to_camera[v]
        own = import_capture.project(capture.rig.intrinsics[v], np.zeros(4), m[:3, :3], m[:3, 3], ring.POINT)
        np.testing.assert_allclose(own, (full + 0.5) / 8, atol=1e-6)
    ring.check_pictures(capture, (0, 1, 2), FRAMES)
    masks = [(ring.mask(v, 1, 255, SIZE) > 0).sum() for v in range(3)]
    found = [next(iter(open_source(capture, "masks").read(v, [10]))) for v in range(3)]
    assert [int((m > 127).sum()) for m in found] == masks
    assert "unit of the cameras: 0.65 m, as camera_scale.pkl says" in capture.notes


def test_the_camera_that_is_wrong_is_left_out_of_the_later_outfits(tmp_path: Path) -> None:
    for outfit, names in (("100065", NAMES), ("100066", NAMES[:2])):
        write(tmp_path / outfit)
        capture = find(tmp_path / outfit)
        assert capture.rig.names == names
    assert any("camera CC32871A041 is left out: its extrinsics are wrong from" in n for n in capture.notes)
    assert find(tmp_path / outfit, exclude=[]).rig.names == NAMES
    assert find(tmp_path / outfit, exclude=[NAMES[0]]).rig.names == NAMES[1:]
    with pytest.raises(UserError, match="option exclude: there is no camera 7; there are CC32871A004"):
        find(tmp_path / outfit, exclude=["7"])


def test_wrong_conventions_and_broken_files_get_a_sentence(base: Path) -> None:
    inverted = extrinsics()
    for given in inverted.values():
        r, t = np.array(given["rotation"]), np.array(given["translation"])
        given["rotation"], given["translation"] = r.T.tolist(), (-r.T @ t).tolist()
    for content, said in (
        (inverted, "other direction"),
        (extrinsics(SCALE / 1000), "at most 1000 m|m apart"),
        (extrinsics(SCALE * 1000), r"0.00\d+ m apart where the files' unit is camera_scale.pkl metres"),
        ({k: {"rotation": []} for k in extrinsics()}, "has no translation of it"),
        ({}, "names none of the cameras CC32871A004"),
        ([], "holds no cameras"),
    ):
        import_capture.dump(base / "camera_extrinsics.json", content)
        with pytest.raises(UserError, match=said):
            find(base)
    import_capture.dump(base / "camera_extrinsics.json", extrinsics())
    half = K * [[0.5], [0.5], [1]]
    for content, said in (
        ({"intrinsics": half.tolist()}, "are for pictures of another size"),
        ({"dist": []}, "has no intrinsics"),
        ({"intrinsics": 1}, "intrinsics has 1 numbers, expected 9"),
    ):
        import_capture.dump(base / "camera_intrinsics.json", content)
        with pytest.raises(UserError, match=said):
            find(base)
    import_capture.dump(base / "camera_intrinsics.json", {"intrinsics": K.tolist(), "dist": []})
    for scale in (-1.0, float("nan"), "x", [1.0]):
        (base / "camera_scale.pkl").write_bytes(pickle.dumps(scale))
        with pytest.raises(UserError, match=r"camera_scale.pkl holds .*; one number, metres in a unit, is expected"):
            find(base)
    (base / "camera_scale.pkl").write_bytes(pickle.dumps(SCALE))
    ring.write_picture(base / "images" / NAMES[0] / "0005_img.jpg", 0, 0, (512, 512))
    with pytest.raises(UserError, match="pictures are 512x512 px, the intrinsics are for 4096x3000; only"):
        find(base)
