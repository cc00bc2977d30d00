"""The catalogue of cameras, K1-K6: paths between cameras, and what calibration files of other systems get wrong."""

from pathlib import Path

import numpy as np
import pytest

from stages.geometry.paths import make_path
from stages.geometry.subject import look_at_point
from stages.io import Views
from storage.capture import SourceFile, Stream
from storage.crop import Crop
from storage.errors import CalibrationError
from storage.importers.cameras import RawCamera, build_rig, check_sizes
from storage.importers.easymocap import _camera, read_opencv_yaml
from storage.rig import CameraPath, Rig
from tests.stages.geometry.scenes import camera, rig_of


def two(degrees: float, subject: np.ndarray) -> Rig:
    """Cameras 2 m from a subject, `degrees` apart."""
    turns = np.radians([0, degrees])
    centres = subject + 2 * np.stack([np.cos(turns), np.sin(turns), np.zeros(2)], axis=1)
    return rig_of([camera(c, subject) for c in centres])


def arc(rig: Rig, steps: int = 9) -> CameraPath:
    return make_path("arc cam0 cam1", rig, Views(rig.names, (0, 1), ()), np.arange(steps))


def centres(path: CameraPath) -> np.ndarray:
    pose = path.world_to_camera[:, 0]
    return -np.einsum("fji,fj->fi", pose[:, :3, :3], pose[:, :3, 3])


@pytest.mark.parametrize("degrees", [22.5, 45, 72, 120, 180])
def test_k1_an_arc_keeps_its_distance_where_interpolated_translations_cut_the_corner(degrees: float) -> None:
    subject = np.array([1.8, 0.3, 0.9])
    rig = two(degrees, subject)
    np.testing.assert_allclose(look_at_point(rig), subject, atol=1e-3)  # parallel axes are held to the cameras' own distance
    np.testing.assert_allclose(np.linalg.norm(centres(arc(rig)) - subject, axis=1), 2.0, atol=1e-3)
    if degrees in (72, 120):  # the naive way: slerped rotation, translation half way
        pose = arc(rig, 3).world_to_camera[1, 0, :3, :3]
        naive = -pose.T @ rig.world_to_camera[:, :3, 3].mean(axis=0)
        assert abs(np.linalg.norm(naive - subject) - 2) > 0.05


@pytest.mark.parametrize("hair", [0.0, 1e-7, -1e-7])
def test_k2_a_half_turn_goes_around_the_rigs_up_axis(hair: float) -> None:
    path = centres(arc(two(180 + np.degrees(hair), np.zeros(3)), 3))
    assert abs(path[1, 2]) < 1e-3  # on the ring, never overhead
    assert abs(np.linalg.norm(path[1]) - 2) < 1e-3


def easymocap(folder: Path, distortion: int) -> RawCamera:
    """A camera written as EasyVolcap's write_camera does: Rot and the vector beside it, T, D of so many numbers."""
    r = camera(np.array([2.0, 0.5, 1.0]), np.zeros(3))

    def node(name: str, values: np.ndarray) -> str:
        m = np.atleast_2d(values.T if values.ndim == 1 else values)
        return f"{name}: !!opencv-matrix\n   rows: {m.shape[0]}\n   cols: {m.shape[1]}\n   dt: d\n   data: [{', '.join(repr(float(x)) for x in m.ravel())}]\n"

    head = '%YAML:1.0\n---\nnames:\n   - "01"\n'
    (folder / "intri.yml").write_text(head + node("K_01", np.array([[800.0, 0, 511.5], [0, 800, 383.5], [0, 0, 1]])) + node("D_01", 0.01 * np.arange(1, distortion + 1)))
    (folder / "extri.yml").write_text(head + node("Rot_01", r[:3, :3]) + node("T_01", r[:3, 3]))
    return _camera("01", read_opencv_yaml(folder / "intri.yml"), read_opencv_yaml(folder / "extri.yml"))


def test_k3_the_centre_follows_from_the_matrix_and_no_file_is_asked_for_it(tmp_path: Path) -> None:
    rig = build_rig([easymocap(tmp_path, 5)], [(1024, 768)], half=False)
    np.testing.assert_allclose(rig.centres[0], [2.0, 0.5, 1.0], atol=1e-12)


@pytest.mark.parametrize("count", [4, 5, 8])
def test_k4_distortion_of_four_five_or_eight_numbers(count: int, tmp_path: Path) -> None:
    rig = build_rig([easymocap(tmp_path, count)], [(1024, 768)], half=False)
    np.testing.assert_allclose(rig.distortion[0], [*(0.01 * np.arange(1, count + 1)), *np.zeros(8 - count)])


@pytest.mark.parametrize("digits", [10, 6, 4])
def test_k5_rotations_rounded_in_text_become_rigid(digits: int) -> None:
    exact = camera(np.array([2.0, 0.5, 1.0]), np.zeros(3))
    r = np.round(exact[:3, :3], digits)
    rig = build_rig([RawCamera("a", np.diag([800.0, 800, 1]), np.zeros(5), r, exact[:3, 3], (1024, 768))], [(1024, 768)], half=False)
    np.testing.assert_allclose(rig.rotations[0] @ rig.rotations[0].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(rig.rotations[0], exact[:3, :3], atol=10.0**-digits)
    with pytest.raises(CalibrationError, match="off a rigid one"):
        build_rig([RawCamera("a", np.diag([800.0, 800, 1]), np.zeros(5), 1.01 * r, exact[:3, 3], (1024, 768))], [(1024, 768)], half=False)


def test_k6_pictures_of_twice_the_calibrated_size_are_refused_until_the_scale_is_said() -> None:
    """Nothing is multiplied by two behind anybody's back."""
    rig = rig_of([camera(np.array([2.0, 0, 0]), np.zeros(3))])
    stream = Stream("images", (SourceFile("/a", "0" * 64, 1, 1),), (0,), (2048, 2048), {})
    with pytest.raises(CalibrationError, match=r"2048x2048.*1024x1024.*scale: 0\.5"):
        check_sizes(rig, [stream], {})
    check_sizes(rig, [stream], {"cam0": Crop(scale=0.5)})
