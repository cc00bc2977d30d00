"""Law: importing what a layout's exporter wrote gives every camera, picture and mask back; others' readers agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.exporters.layouts.colmap import quaternion
from posegaussian.storage.exporters.layouts.declaration import Recording, check_folder, write_pictures
from posegaussian.storage.exporters.layouts.registry import LAYOUTS
from posegaussian.storage.formats.colmap_model import read_model, rotation_of
from posegaussian.storage.formats.ply import read_ply
from posegaussian.storage.importers.cameras import rotation_matrix
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.importers.registry import IMPORTERS
from posegaussian.storage.model.cameras import Rig, rigid
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.support.pycolmap_process import ask

NUMBERS = ((4, 5, 9), (4, 9), (4, 5, 9), (4, 5, 9))
NAMES = ("cam2", "cam10", "left", "01")
SIZES = np.array([[17, 13], [13, 17], [17, 13], [16, 12]])


def looking_at(centre: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.3, 1.0, 0.2])
    right /= np.linalg.norm(right)
    r = np.stack([right, np.cross(forward, right), forward])
    r = rotation_matrix(np.array([0.0, 0.0, roll])) @ r
    return rigid(r, -r @ centre)


@pytest.fixture
def recording() -> Recording:
    rng = np.random.default_rng(2)
    intrinsics = np.tile(np.eye(3), (4, 1, 1))
    intrinsics[:, [0, 1], [0, 1]] = rng.uniform(20, 30, (4, 2))
    intrinsics[:, :2, 2] = rng.uniform(5, 9, (4, 2))
    pose = np.stack(
        [looking_at(c, np.zeros(3), a) for c, a in zip(rng.normal(size=(4, 3)) * 2, (0, 3.1, 1, -2), strict=True)]
    )
    rig = Rig(NAMES, intrinsics, np.zeros((4, 8)), pose, SIZES)
    points, colors = rng.normal(size=(30, 3)), rng.integers(0, 256, (30, 3), np.uint8)
    return Recording(rig, 25.0, NUMBERS, True, ("left",), points, colors)


def picture(v: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([v, n])
    w, h = SIZES[v]
    return rng.integers(0, 256, (h, w, 3), np.uint8), rng.integers(0, 256, (h, w), np.uint8)


def export(name: str, folder: Path, recording: Recording) -> None:
    LAYOUTS[name].write(folder, recording)
    count = write_pictures(folder, recording.rig, ((v, n, *picture(v, n)) for v, n, _ in recording.images()))
    assert count == 11


@pytest.mark.parametrize("name", LAYOUTS)
def test_importing_what_was_exported_gives_it_back(tmp_path: Path, recording: Recording, name: str) -> None:
    assert name in IMPORTERS
    export(name, tmp_path, recording)
    capture = find_capture("auto", tmp_path, {})
    assert capture.layout == name
    rig = capture.rig
    assert set(rig.names) == set(NAMES)
    assert sorted({int(n) for n in capture.numbers}) == [4, 5, 9]
    for own, cam in enumerate(rig.names):
        v = NAMES.index(cam)
        np.testing.assert_array_equal(rig.size[own], SIZES[v])
        # quaternions, Rodrigues vectors and inversions of float64
        np.testing.assert_allclose(rig.intrinsics[own], recording.rig.intrinsics[v], rtol=0, atol=1e-12)
        np.testing.assert_allclose(rig.world_to_camera[own], recording.rig.world_to_camera[v], rtol=0, atol=1e-12)
        assert not rig.distortion[own].any()
        assert list(capture.pictures[own].numbers) == list(NUMBERS[v])
        for kind, at in (("pictures", 0), ("masks", 1)):
            back = list(open_source(capture, kind).read(own, NUMBERS[v]))
            for n, found in zip(NUMBERS[v], back, strict=True):
                np.testing.assert_array_equal(found, picture(v, n)[at])
    if name in ("images", "nerfstudio"):
        assert capture.held_out == ("left",)
    if name == "images":
        assert capture.frame_rate == 25


def test_pycolmap_reads_what_is_written(tmp_path: Path, recording: Recording) -> None:
    export("colmap", tmp_path, recording)
    theirs = ask("content", folder=str(tmp_path / "sparse" / "0"))
    assert sorted(theirs["images"]) == sorted(name for _, _, name in recording.images())
    rig = recording.rig
    for name, image in theirs["images"].items():
        v = NAMES.index(name.split("/")[0])
        k = rig.intrinsics[v]
        np.testing.assert_allclose(image["pose"], rig.world_to_camera[v, :3], atol=1e-14)
        # both put the first pixel's centre at 0.5
        np.testing.assert_array_equal(image["params"], [k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
        assert tuple(image["size"]) == tuple(rig.size[v])
    for key, point in theirs["points"].items():
        np.testing.assert_array_equal(point, [*recording.points[int(key) - 1], *recording.colors[int(key) - 1]])


def test_the_cloud_is_a_plain_ply(tmp_path: Path, recording: Recording) -> None:
    export("nerfstudio", tmp_path, recording)
    vertex = read_ply(tmp_path / "points.ply").elements["vertex"]
    np.testing.assert_array_equal(np.stack([vertex[a] for a in "xyz"], 1), recording.points.astype(np.float32))
    np.testing.assert_array_equal(np.stack([vertex[c] for c in ("red", "green", "blue")], 1), recording.colors)


def test_opencv_reads_what_is_written_for_easymocap(tmp_path: Path, recording: Recording) -> None:
    import cv2

    export("easymocap", tmp_path, recording)
    intri, extri = (cv2.FileStorage(str(tmp_path / f), cv2.FILE_STORAGE_READ) for f in ("intri.yml", "extri.yml"))
    names = intri.getNode("names")
    assert tuple(names.at(i).string() for i in range(names.size())) == NAMES
    for v, cam in enumerate(NAMES):
        k = intri.getNode(f"K_{cam}").mat()
        np.testing.assert_allclose(k[:2, 2], recording.rig.intrinsics[v, :2, 2] - 0.5, atol=1e-13)
        turned = cv2.Rodrigues(extri.getNode(f"R_{cam}").mat())[0]
        np.testing.assert_allclose(turned, recording.rig.rotations[v], atol=1e-12)
        assert (intri.getNode(f"W_{cam}").real(), intri.getNode(f"H_{cam}").real()) == tuple(SIZES[v])


def test_quaternions_of_all_angles_turn_back() -> None:
    rng = np.random.default_rng(4)
    for angle in (0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi):
        axis = rng.normal(size=3)
        r = rotation_matrix(angle * axis / np.linalg.norm(axis))
        np.testing.assert_allclose(rotation_of(quaternion(r), "here"), r, atol=1e-14)


def test_pictures_of_something_else_are_not_mixed_in(tmp_path: Path, recording: Recording) -> None:
    export("colmap", tmp_path, recording)
    check_folder(tmp_path, recording.rig, [4, 5, 9])
    with pytest.raises(UserError, match="of something else, for example"):
        check_folder(tmp_path, recording.rig, [4, 5])
    assert len(read_model(tmp_path / "sparse" / "0").images) == 11


def test_a_name_that_opencv_cannot_hold_is_refused(tmp_path: Path, recording: Recording) -> None:
    named = Recording(**{**vars(recording), "rig": Rig(("cam a", *NAMES[1:]), *list(vars(recording.rig).values())[1:])})
    with pytest.raises(UserError, match="camera 'cam a' cannot be a key of OpenCV's YAML"):
        LAYOUTS["easymocap"].write(tmp_path, named)
