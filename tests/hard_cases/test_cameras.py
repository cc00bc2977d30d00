"""The catalogue of cameras, K1-K6: paths between cameras, and what calibration files of other systems get wrong."""

import numpy as np
import pytest

from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.storage.importers.cameras import RawCamera, build_rig
from posegaussian.storage.model.errors import CalibrationError
from tests.hard_cases.cases_cameras import arc, as_captured, centres, doubled, two, written
from tests.support.known_geometry import camera


@pytest.mark.parametrize("degrees", [22.5, 45, 72, 120, 180])
def test_k1_an_arc_keeps_its_distance_where_interpolated_translations_cut_the_corner(degrees: float) -> None:
    subject = np.array([1.8, 0.3, 0.9])
    rig = two(degrees, subject)
    # parallel axes are held to the cameras' own distance
    np.testing.assert_allclose(look_at_point(rig), subject, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(centres(arc(rig)) - subject, axis=1), 2.0, atol=1e-3)


@pytest.mark.parametrize("hair", [0.0, 1e-7, -1e-7])
def test_k2_a_half_turn_goes_around_the_rigs_up_axis(hair: float) -> None:
    path = centres(arc(two(180 + np.degrees(hair), np.zeros(3)), 3))
    assert abs(path[1, 2]) < 1e-3  # on the ring, never overhead
    assert abs(np.linalg.norm(path[1]) - 2) < 1e-3


def test_k3_the_centre_follows_from_the_matrix_and_no_file_is_asked_for_it() -> None:
    np.testing.assert_allclose(written(5).centres[0], [2.0, 0.5, 1.0], atol=1e-12)


@pytest.mark.parametrize("count", [4, 5, 8])
def test_k4_distortion_of_four_five_or_eight_numbers(count: int) -> None:
    np.testing.assert_allclose(written(count).distortion[0], [*(0.01 * np.arange(1, count + 1)), *np.zeros(8 - count)])


@pytest.mark.parametrize("digits", [10, 6, 4])
def test_k5_rotations_rounded_in_text_become_rigid(digits: int) -> None:
    exact = camera(np.array([2.0, 0.5, 1.0]), np.zeros(3))
    r = np.round(exact[:3, :3], digits)
    rig = build_rig(
        [RawCamera("a", np.diag([800.0, 800, 1]), np.zeros(5), r, exact[:3, 3], (1024, 768))], [(1024, 768)], half=False
    )
    np.testing.assert_allclose(rig.rotations[0] @ rig.rotations[0].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(rig.rotations[0], exact[:3, :3], atol=10.0**-digits)
    with pytest.raises(CalibrationError, match="off a rigid one"):
        build_rig(
            [RawCamera("a", np.diag([800.0, 800, 1]), np.zeros(5), 1.01 * r, exact[:3, 3], (1024, 768))],
            [(1024, 768)],
            half=False,
        )


def test_k6_pictures_of_twice_the_calibrated_size_are_scaled_and_the_calibration_stays() -> None:
    """Nothing is multiplied by two behind anybody's back: the scale is found, said, and kept beside the calibration."""
    assert doubled() == 0.0
    assert "2048x2048 px, the calibration is for 1024x1024 px: the same shape" in as_captured(2048).notes[0]
