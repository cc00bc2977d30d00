"""OpenCV's FileStorage for `import videos`: one file or one a camera, YAML or JSON, several spellings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.errors import UserError
from tests.storage.importers.test_videos import NAMES, films, find
from tests.support import ring


def rodrigues(rotation: np.ndarray) -> np.ndarray:
    """[3] axis times angle of a rotation [3, 3] that is no half turn."""
    angle = np.arccos((np.trace(rotation) - 1) / 2)
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return np.asarray(axis / (2 * np.sin(angle)) * angle)


def matrix(values: np.ndarray) -> str:
    """As OpenCV writes a matrix into YAML."""
    rows, cols = np.atleast_2d(values).shape
    data = ", ".join(repr(float(x)) for x in np.ravel(values))
    return f"!!opencv-matrix\n      rows: {rows}\n      cols: {cols}\n      dt: d\n      data: [ {data} ]"


def one_file(base: Path) -> None:
    """YAML with a node a camera, matrices of rotation."""
    text = "%YAML:1.0\n---\n"
    for v, name in enumerate(NAMES):
        text += f"{name}:\n   camera_matrix: {matrix(ring.intrinsics(v))}\n"
        text += f"   dist_coeffs: {matrix(ring.DISTORTION)}\n"
        text += f"   R: {matrix(ring.rotation(v))}\n   T: {matrix(ring.translation(v)[:, None])}\n"
        text += f"   image_width: {ring.SIZE[0]}\n   image_height: {ring.SIZE[1]}\n"
    (base / "rig.yml").write_text(text)


def camera(v: int) -> dict[str, Any]:
    """A camera as OpenCV writes it into JSON, with vectors of rotation."""

    def stored(values: np.ndarray) -> dict[str, Any]:
        rows, cols = np.atleast_2d(values).shape
        return {"type_id": "opencv-matrix", "rows": rows, "cols": cols, "dt": "d", "data": np.ravel(values).tolist()}

    return {
        "cameraMatrix": stored(ring.intrinsics(v)),
        "distortion_coefficients": stored(ring.DISTORTION),
        "rvec": stored(rodrigues(ring.rotation(v))),
        "tvec": stored(ring.translation(v)),
    }


def a_file_each(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    for v, name in enumerate(NAMES):
        (folder / f"{name}.json").write_text(json.dumps(camera(v)))


def listed(base: Path, *changed: dict[str, Any]) -> None:
    """JSON with a list of cameras; `changed` replaces the last one's values."""
    nodes = [{"name": n, **camera(v)} for v, n in enumerate(NAMES)]
    for values in changed:
        nodes[-1].update(values)
    (base / "rig.json").write_text(json.dumps({"cameras": nodes}))


@pytest.fixture
def base(tmp_path: Path) -> Path:
    films(tmp_path)
    return tmp_path


def test_one_file(base: Path) -> None:
    one_file(base)
    capture = find_capture("auto", base, {})
    assert "layout: videos" in capture.notes
    assert "calibration: rig.yml, OpenCV FileStorage" in capture.notes
    assert any(n.startswith("unit: taken as metres") for n in capture.notes)
    ring.check_cameras(capture, (0, 1, 2))
    np.testing.assert_allclose(capture.rig.distortion[0, :5], ring.DISTORTION)


def test_one_file_a_camera(base: Path) -> None:
    a_file_each(base)
    ring.check_cameras(find(base), (0, 1, 2))
    for p in base.glob("*.json"):
        p.unlink()
    a_file_each(base / "calibration")
    ring.check_cameras(find(base, calibration="calibration"), (0, 1, 2))
    listed(base / "calibration")
    with pytest.raises(UserError, match=r"camera cam0 is in another file of .*calibration, too; name the file"):
        find(base, calibration="calibration")


def test_a_list_and_plain_numbers(base: Path) -> None:
    listed(base, {"cameraMatrix": ring.intrinsics(2).tolist(), "tvec": ring.translation(2).tolist()})
    ring.check_cameras(find(base), (0, 1, 2))
    ring.check_cameras(find(base, cameras="cam2,cam0"), (2, 0))


def test_pictures_cut_beside_their_principal_point_are_taken_where_the_file_says_their_size(base: Path) -> None:
    """With the doubt that the intrinsics are for another size. Where it says none, its principal point is all there is
    to tell that they are."""
    cut = ring.intrinsics(2)
    cut[:2, 2] = 0.3 * np.array(ring.SIZE)
    listed(base, {"cameraMatrix": cut.tolist(), "image_size": list(ring.SIZE)})
    capture = find(base)
    np.testing.assert_allclose(capture.rig.intrinsics[2, :2, 2], cut[:2, 2] + 0.5)
    assert any("in cam2 as if the intrinsics were for pictures of another size" in n for n in capture.notes)
    listed(base, {"cameraMatrix": cut.tolist()})
    with pytest.raises(UserError, match=r"camera cam2: .* the intrinsics are for pictures of another size"):
        find(base)


def test_wrong_conventions_get_a_sentence(base: Path) -> None:
    turned = ring.rotation(2).T
    for changed, said in (
        ({"R": turned.tolist()}, "camera cam2: R and rvec in .* are different rotations"),
        ({"rvec": None}, "camera cam2: .* has none of R, rvec, .*; calibrate where the camera stands"),
        ({"tvec": None}, "camera cam2: .* has none of T, tvec"),
        ({"distortion_coefficients": None}, "camera cam2: .* has none of dist_coeffs, .*; write zeros where there is"),
        ({"fisheye_model": 1}, "camera cam2: fisheye_model is set"),
        ({"cameraMatrix": [[1]]}, "camera cam2: the camera's matrix has 1 numbers, expected 9"),
        ({"name": "cam1"}, "must hold a camera, .* or cameras of different names; it has"),
        ({"tvec": (1000 * ring.translation(2)).tolist()}, "metres would be between 0.2 and 20"),
        ({"rvec": [200.0, 0, 0]}, "is it in degrees"),
        ({"image_size": [32.5, 24]}, r"picture size \[32.5, 24.0\] px must be two whole numbers"),
        ({"cameraMatrix": (2 * ring.intrinsics(2)).tolist()}, "the intrinsics are for pictures of another size"),
    ):
        listed(base, changed)
        with pytest.raises(UserError, match=said):
            find(base)
    inverted = [{"name": n, **camera(v), "rvec": rodrigues(ring.rotation(v).T).tolist(),
                 "tvec": ring.centre(v).tolist()} for v, n in enumerate(NAMES)]  # fmt: skip
    (base / "rig.json").write_text(json.dumps({"cameras": inverted}))
    with pytest.raises(UserError, match="the poses were written in the other direction"):
        find(base)


def test_other_json_and_yaml_is_none_of_it(base: Path) -> None:
    (base / "notes.json").write_text('{"K": [1, 2, 3]}')
    (base / "settings.yml").write_text("K: 1\n")
    with pytest.raises(UserError, match="holds 0 calibrations"):
        find(base)
