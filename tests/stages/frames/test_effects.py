"""How far lenses and crops move pixels, against OpenCV's lens model and plain arithmetic; when light is steadied."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.stages.frames.effects import DRIFT, LIGHT_STEADYING
from posegaussian.stages.imaging.camera_mapping import frames_rig, switched
from posegaussian.stages.imaging.pixel_effects import crop_displacement, lens_displacement
from posegaussian.stages.imaging.steady_light import UNTOLD
from posegaussian.stages.simulator.subjects.capsule_person import ring


def test_lens_displacement_is_the_largest_of_opencv_s_over_the_picture() -> None:
    rig = ring(2, 200, 0)
    lens = np.array([-0.2, 0.05, 0.001, -0.002, 0.01, 0, 0, 0.0])
    source = replace(rig, distortion=np.stack([lens, np.zeros(8)]))
    moved = lens_displacement(rig, source)
    k = rig.intrinsics[0]
    edge = np.stack(np.meshgrid(np.linspace(0, 200, 81), np.linspace(0, 200, 81)), axis=-1).reshape(-1, 2)
    ideal = np.concatenate([(edge - k[:2, 2]) / k[[0, 1], [0, 1]], np.ones((len(edge), 1))], axis=1)
    there = cv2.projectPoints(ideal, np.zeros(3), np.zeros(3), k, lens)[0].reshape(-1, 2)
    assert moved[0] == pytest.approx(np.linalg.norm(there - edge, axis=1).max(), rel=1e-6)
    assert moved[1] == 0.0


def test_displacements_are_counted_in_pixels_that_are_worked_on() -> None:
    source = replace(ring(1, 200, 0), distortion=np.array([[-0.2, 0, 0, 0, 0, 0, 0, 0.0]]))
    half = frames_rig(source, 100)
    full = frames_rig(source, None)
    assert lens_displacement(half, source)[0] == pytest.approx(lens_displacement(full, source)[0] / 2)
    crops, size = np.array([[1.01, 0.0, -4.0]]), np.array([[200, 200]])
    # The lower right corner moves by (2, -2), the upper right by (2, -4): the latter is the farthest.
    assert crop_displacement(full, source, size, crops)[0] == pytest.approx(np.hypot(2, 4))
    assert crop_displacement(half, source, size, crops)[0] == pytest.approx(np.hypot(2, 4) / 2)
    assert crop_displacement(full, source, size, np.array([[1.0, 0, 0]]))[0] == 0.0


def test_what_is_off_is_as_if_the_calibration_had_none() -> None:
    source = replace(ring(2, 50, 0), distortion=np.full((2, 8), 0.1))
    crops = np.array([[1.1, 2.0, 3.0], [1, 0, 0]])
    lens, moved = switched(source, crops, frozenset({"undistortion", "crop_scale"}))
    assert lens is source
    assert moved is crops
    lens, moved = switched(source, crops, frozenset())
    assert not lens.distortion.any()
    np.testing.assert_array_equal(moved, np.tile([1.0, 0, 0], (2, 1)))
    np.testing.assert_array_equal(lens.intrinsics, source.intrinsics)


def drifting(*stops: np.ndarray, facts: frozenset[str] = frozenset({"several_frames", "person_matte"})) -> Any:
    """Evidence of cameras whose pictures are so many stops [frame, channel] brighter than usual."""
    rig = ring(len(stops), 64, 0)
    return SimpleNamespace(rig=rig, sources=tuple(range(len(stops))), facts=facts, noted={DRIFT: np.stack(stops)})


def test_light_is_steadied_where_one_channel_of_one_camera_changes_enough() -> None:
    bound = LIGHT_STEADYING.threshold
    still, changing = np.zeros((4, 3)), np.zeros((4, 3))
    changing[2, 1] = 1.1 * bound
    found = LIGHT_STEADYING.decide(drifting(still, changing), bound)
    assert found is not None
    assert (found.on, found.measured) == (True, pytest.approx(1.1 * bound))
    assert "0.22 stops in cam01" in found.reason
    changing[2, 1] = 0.9 * bound
    quiet = LIGHT_STEADYING.decide(drifting(still, changing), bound)
    assert quiet is not None
    assert not quiet.on


def test_pictures_whose_light_nothing_tells_decide_nothing() -> None:
    """One that is hidden counts for nothing among those that are not, and a camera of which none is left, too."""
    hidden = np.zeros((4, 3))
    hidden[1] = UNTOLD
    found = LIGHT_STEADYING.decide(drifting(hidden, np.full((4, 3), UNTOLD)), LIGHT_STEADYING.threshold)
    assert found is not None
    assert (found.on, found.measured) == (False, 0.0)
    nothing = LIGHT_STEADYING.decide(drifting(np.full((4, 3), UNTOLD)), LIGHT_STEADYING.threshold)
    assert nothing is not None
    assert (nothing.on, nothing.measured) == (False, None)
    assert LIGHT_STEADYING.decide(SimpleNamespace(noted={}), LIGHT_STEADYING.threshold) is None


@pytest.mark.parametrize(
    ("facts", "why"),
    [
        ({"person_matte"}, "single frame"),
        ({"several_frames", "plate_matte", "linear_light"}, "linear light"),
        ({"several_frames", "given_matte"}, "masks are given"),
        ({"several_frames", "plate_matte"}, None),
    ],
)
def test_light_is_steadied_only_where_a_plate_tells_it(facts: set[str], why: str | None) -> None:
    lacks = LIGHT_STEADYING.lacks(drifting(np.zeros((4, 3)), facts=frozenset(facts)))
    assert (lacks is None) if why is None else (lacks is not None and why in lacks)
