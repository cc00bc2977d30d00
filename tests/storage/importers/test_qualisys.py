"""Qualisys' calibration: a rig written as one comes back, and a sentence for everything wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.cameras import Rig, to_integer_centres
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError
from tests.storage.importers.test_pose2sim import write_calibration
from tests.support import import_capture
from tests.support.video_clips import counting_clip

SENSOR = (80, 60)
"""Columns and rows of the sensor; the filmed part of it is `import_capture.SIZE`, from column 10, row 5 on."""
CORNER = (10, 5)


def camera(rig: Rig, v: int, **changes: str) -> str:
    """One camera element, by the format's own words:
    place and axes in the world, x right, y up, z backwards, mm and 1/64 px."""
    right, down, forward = rig.rotations[v]
    axes = {f"r{i}{j}": value for i, row in enumerate((right, -down, -forward), 1) for j, value in enumerate(row, 1)}
    place = dict(zip("xyz", 1000 * rig.centres[v], strict=True))
    k, (k1, k2, p1, p2, k3) = to_integer_centres(rig.intrinsics)[v], rig.distortion[v, :5]
    inner = {
        "focalLengthU": 64 * k[0, 0],
        "focalLengthV": 64 * k[1, 1],
        "skew": 0,
        "centerPointU": 64 * (k[0, 2] + CORNER[0]),
        "centerPointV": 64 * (k[1, 2] + CORNER[1]),
        "radialDistortion1": k1,
        "radialDistortion2": k2,
        "radialDistortion3": k3,
        "tangentalDistortion1": p1,
        "tangentalDistortion2": p2,
    }
    seen = {
        "left": CORNER[0],
        "top": CORNER[1],
        "right": CORNER[0] + import_capture.SIZE[0] - 1,
        "bottom": CORNER[1] + import_capture.SIZE[1] - 1,
    }
    head = {"active": "1", "serial": rig.names[v], "viewrotation": "0"}

    def element(name: str, values: dict[str, Any]) -> str:
        return (
            f"<{name} "
            + " ".join(f'{key}="{changes.get(key, value)}"' for key, value in values.items() if changes.get(key) != "")
            + "/>"
        )

    whole = {"left": 0, "top": 0, "right": SENSOR[0] - 1, "bottom": SENSOR[1] - 1}
    parts = (
        element("fov_video_max", whole)
        + element("fov_video", seen)
        + element("transform", {**place, **axes})
        + element("intrinsic", inner)
    )
    return element("camera", head).replace("/>", f">{parts}</camera>")


def write_qca(path: Path, rig: Rig, **changes: str) -> None:
    body = "".join(camera(rig, v, **(changes if v == 0 else {})) for v in range(len(rig)))
    path.write_text(
        '<?xml version="1.0" encoding="ASCII"?><calibration><results'
        f' std-dev="0."/><cameras>{body}</cameras></calibration>'
    )


@pytest.fixture
def base(tmp_path: Path) -> Path:
    (tmp_path / "videos").mkdir()
    for name in import_capture.NAMES:
        counting_clip(tmp_path / "videos" / f"{name}.mp4", 3, import_capture.SIZE)
    write_calibration(tmp_path)
    write_qca(tmp_path / "own.qca.txt", find(tmp_path).rig)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("pose2sim", base, options)


def test_a_rig_written_as_qualisys_comes_back(base: Path) -> None:
    toml, own = find(base), find(base, calibration="own.qca.txt")
    assert toml.notes[0] == "calibration: calib/Calib.toml"
    assert own.notes[0] == "calibration: own.qca.txt"
    # decimal text and 64ths of a pixel lose a few of float64's last digits, no more
    for part in ("intrinsics", "distortion", "world_to_camera", "size"):
        np.testing.assert_allclose(getattr(own.rig, part), getattr(toml.rig, part), atol=1e-9)
    np.testing.assert_allclose(import_capture.imported_pixels(own.rig), import_capture.known_pixels() + 0.5, atol=1e-9)


def test_it_is_taken_by_itself_where_there_is_no_toml(base: Path) -> None:
    (base / "calib" / "Calib.toml").unlink()
    assert find(base).notes[0] == "calibration: own.qca.txt"
    write_qca(base / "other.qca", find(base).rig)
    with pytest.raises(
        CalibrationError,
        match=r"several calibrations fit: other\.qca, own\.qca\.txt; choose one with the option calibration",
    ):
        find(base)


def test_k3_is_read_and_the_order_is_opencv_s(base: Path) -> None:
    write_qca(base / "own.qca.txt", find(base).rig, radialDistortion3="0.25")
    np.testing.assert_allclose(
        find(base, calibration="own.qca.txt").rig.distortion[0],
        [*import_capture.DISTORTION[0], 0.25, 0, 0, 0],
        atol=1e-15,
    )


def test_a_serial_is_found_at_the_end_of_a_videos_name(base: Path) -> None:
    rig = find(base).rig
    numbered = Rig(("00001", "2", "10"), rig.intrinsics, rig.distortion, rig.world_to_camera, rig.size)
    write_qca(base / "own.qca.txt", numbered)
    np.testing.assert_allclose(
        find(base, calibration="own.qca.txt").rig.world_to_camera, rig.world_to_camera, atol=1e-9
    )


WRONG: dict[str, tuple[dict[str, str], str]] = {
    "turned": ({"viewrotation": "90"}, r"own\.qca\.txt, camera cam1: viewrotation 90 must be 0, .*set it to 0 in QTM"),
    "off": ({"active": "0"}, r"video .*cam1\.mp4 has no calibration in own\.qca\.txt, which holds cam2, cam10"),
    "twice": ({"serial": "cam2"}, "camera 2 has the serial 'cam2'; each needs one of its own"),
    "no serial": ({"serial": ""}, "camera 1 has the serial ''"),
    "text": ({"x": "far"}, "camera cam1: transform x 'far' is not a number"),
    "missing": ({"r23": ""}, "camera cam1 has no transform r23; export"),
    "no lens": ({"tangentalDistortion2": ""}, "camera cam1 has no intrinsic tangentalDistortion2"),
    "mirrored": ({"r21": "0", "r22": "0", "r23": "0"}, "camera cam1: the rotation is off a rigid one"),
    "skew": ({"skew": "640"}, "camera cam1: skew 10 px must be 0"),
    "other size": ({"right": "90"}, "camera cam1: pictures are 64x48 px, the calibration is for 81x48 px"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_get_a_sentence(base: Path, case: str) -> None:
    changes, sentence = WRONG[case]
    write_qca(base / "own.qca.txt", find(base).rig, **changes)
    with pytest.raises(CalibrationError, match=sentence):
        find(base, calibration="own.qca.txt")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("no xml", r"own\.qca\.txt cannot be read: syntax error"),
        ("<calibration/>", "holds no cameras/camera; export it"),
    ],
)
def test_what_is_no_calibration_gets_a_sentence(base: Path, text: str, sentence: str) -> None:
    (base / "own.qca.txt").write_text(text)
    with pytest.raises(CalibrationError, match=sentence):
        find(base, calibration="own.qca.txt")
