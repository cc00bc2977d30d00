"""Laws of cameras: half-pixel conversions invert each other, faults are named, paths are known by their cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.storage.model.cameras import (
    CameraPath,
    Rig,
    camera_centre,
    from_integer_centres,
    points_from_integer_centres,
    points_to_integer_centres,
    rigid,
    rotation_matrix,
    to_integer_centres,
)
from posegaussian.storage.model.errors import CalibrationError, UserError
from tests.support.sample_captures import make_rig

QUICK = settings(max_examples=50)


@QUICK
@given(st.integers(0, 999))
def test_conversions_of_pixel_centres_invert_each_other_and_move_half_a_pixel(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = rng.uniform(-3000, 3000, (2, 3, 3)).round(3)
    before = k.copy()
    # adding and taking away 0.5 is exact up to one rounding of numbers around 3000
    np.testing.assert_allclose(to_integer_centres(from_integer_centres(k)), k, rtol=0, atol=1e-12)
    np.testing.assert_allclose(from_integer_centres(to_integer_centres(k)), k, rtol=0, atol=1e-12)
    moved = from_integer_centres(k) - k
    wanted = np.zeros((3, 3))
    wanted[:2, 2] = 0.5
    np.testing.assert_allclose(moved, np.broadcast_to(wanted, moved.shape), atol=1e-12)
    np.testing.assert_array_equal(k, before)
    points = rng.uniform(-100, 5000, (4, 5, 2))
    np.testing.assert_allclose(
        points_to_integer_centres(points_from_integer_centres(points)), points, rtol=0, atol=1e-12
    )


@QUICK
@given(st.integers(0, 999))
def test_projecting_and_converting_commute(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
    point = rng.uniform([-1, -1, 2], [1, 1, 5])

    def project(intrinsics: np.ndarray) -> np.ndarray:
        p = intrinsics @ point
        return p[:2] / p[2]

    np.testing.assert_allclose(project(from_integer_centres(k)), points_from_integer_centres(project(k)), atol=1e-9)


def test_the_first_pixel_of_opencv_is_half_a_pixel_in() -> None:
    np.testing.assert_array_equal(points_from_integer_centres(np.array([0.0, 0.0])), [0.5, 0.5])


@QUICK
@given(st.integers(0, 999))
def test_rigid_gives_the_nearest_rotation_and_keeps_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m = rigid(rng.normal(size=(3, 3)), rng.normal(size=3))
    np.testing.assert_allclose(m[:3, :3] @ m[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(m[:3, :3]) > 0
    np.testing.assert_allclose(rigid(m[:3, :3], m[:3, 3]), m, atol=1e-12)
    np.testing.assert_array_equal(m[3], [0, 0, 0, 1])


def test_centres_are_where_the_camera_coordinates_vanish() -> None:
    rig = make_rig(5)
    rig.check()
    at_camera = np.einsum("vij,vj->vi", rig.rotations, rig.centres) + rig.world_to_camera[:, :3, 3]
    np.testing.assert_allclose(at_camera, 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rig.centres, axis=1), 3, atol=1e-12)
    np.testing.assert_allclose([camera_centre(p) for p in rig.world_to_camera], rig.centres, atol=1e-14)


def changed(rig: Rig, field: str, index: tuple[int, ...], value: float) -> Rig:
    array = getattr(rig, field).copy()
    array[index] = value
    return replace(rig, **{field: array})


FAULTS = {
    "nan in the intrinsics": ("intrinsics", (1, 0, 2), np.nan, "nan"),
    "infinite distortion": ("distortion", (1, 3), np.inf, "inf"),
    "nan in the motion": ("world_to_camera", (1, 0, 3), np.nan, "nan"),
    "negative focal length": ("intrinsics", (1, 0, 0), -5.0, "-5"),
    "zero focal length": ("intrinsics", (1, 1, 1), 0.0, "0"),
    "scaled rotation": ("world_to_camera", (1, 1, 1), 1.01, "0.02"),
    "last row of the motion": ("world_to_camera", (1, 3, 3), 2.0, "2.0"),
    "empty picture": ("size", (1, 0), 0, "(0, 30)"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_camera_is_named_with_the_value(fault: str) -> None:
    field, index, value, shown = FAULTS[fault]
    with pytest.raises(CalibrationError, match="camera cam02") as error:
        changed(make_rig(3), field, index, value).check()
    assert shown in str(error.value)
    assert "np." not in str(error.value)
    assert isinstance(error.value, UserError)


def test_a_mirrored_rotation_is_not_rigid() -> None:
    rig = make_rig(3)
    mirrored = rig.world_to_camera.copy()
    mirrored[2, 0, :3] *= -1
    with pytest.raises(CalibrationError, match=r"cam03.*determinant -1"):
        replace(rig, world_to_camera=mirrored).check()


def test_rounding_of_text_files_is_accepted() -> None:
    rig = make_rig(7)
    replace(rig, world_to_camera=rig.world_to_camera.round(4)).check()


def test_a_name_that_occurs_twice_is_refused_with_its_count() -> None:
    with pytest.raises(CalibrationError, match="'cam01' occurs 2 times"):
        replace(make_rig(3), names=("cam01", "cam02", "cam01")).check()


def test_an_unknown_camera_lists_the_known_ones() -> None:
    with pytest.raises(CalibrationError, match=r"'cam9'.*cam01, cam02, cam03"):
        make_rig(3).index("cam9")


def test_a_subset_keeps_order_and_content() -> None:
    rig = make_rig(4)
    part = rig.subset([2, 0])
    assert part.names == ("cam03", "cam01")
    np.testing.assert_array_equal(part.world_to_camera, rig.world_to_camera[[2, 0]])
    assert part.subset([1, 0]).digest == rig.subset([0, 2]).digest
    assert part.digest != rig.subset([0, 2]).digest


def make_path() -> CameraPath:
    rig = make_rig(2)
    frames = 3
    k, m = np.tile(rig.intrinsics, (frames, 1, 1, 1)), np.tile(rig.world_to_camera, (frames, 1, 1, 1))
    return CameraPath("orbit", ("a", "b"), k, m, rig.size, np.ones((frames, 2), bool))


def test_a_path_keeps_its_name_while_its_cameras_stay() -> None:
    assert make_path().name == make_path().name
    kind, _, suffix = make_path().name.partition("-")
    assert kind == "orbit"
    assert len(suffix) == 8
    assert replace(make_path(), intrinsics=np.asfortranarray(make_path().intrinsics)).name == make_path().name


def test_what_asked_for_a_path_goes_with_it_and_changes_no_name() -> None:
    asked = replace(make_path(), text="orbit")
    assert asked.slice(slice(1, 3)).text == "orbit"
    assert asked.name == make_path().name


@pytest.mark.parametrize(
    ("field", "index", "value"),
    [
        ("intrinsics", (2, 1, 0, 2), 20.5),
        ("world_to_camera", (0, 0, 2, 3), 3.5),
        ("size", (1, 1), 31),
        ("served", (1, 0), False),
    ],
)
def test_a_path_is_renamed_when_any_camera_changes(field: str, index: tuple[int, ...], value: float) -> None:
    path = make_path()
    array = getattr(path, field).copy()
    array[index] = value
    assert replace(path, **{field: array}).name != path.name
    assert replace(path, names=("a", "c")).name != path.name
    assert replace(path, kind="arc").name != path.name


def test_standing_cameras_keep_their_name_over_any_frames_and_moving_ones_do_not() -> None:
    """So that appended frames add to the pictures of a path instead of beginning a new one."""
    path = make_path()
    assert path.slice(slice(0, 1)).name == path.slice(slice(1, 3)).name == path.name
    moving = path.world_to_camera.copy()
    moving[2, 0, 0, 3] += 0.1
    moved = replace(path, world_to_camera=moving)
    assert (
        len({moved.name, moved.slice(slice(0, 2)).name, moved.slice(slice(1, 3)).name, moved.slice(slice(2, 3)).name})
        == 4
    )


def test_a_slice_of_a_path_holds_its_frames() -> None:
    part = make_path().slice(slice(1, 3))
    assert part.intrinsics.shape[0] == part.world_to_camera.shape[0] == part.served.shape[0] == 2
    assert part.names == ("a", "b")


def test_a_rotation_by_a_vector_keeps_it_and_turns_what_is_across() -> None:
    w = np.array([0.3, -0.2, 0.5])
    r = rotation_matrix(w)
    assert np.allclose(r @ w, w)
    assert np.allclose(r @ r.T, np.eye(3))
    across = np.cross(w, [1.0, 0, 0])
    cosine = (r @ across) @ across / (across @ across)
    assert np.arccos(cosine) == pytest.approx(np.linalg.norm(w))
    assert np.allclose(rotation_matrix(-w), r.T)
    assert np.array_equal(rotation_matrix(np.zeros(3)), np.eye(3))
