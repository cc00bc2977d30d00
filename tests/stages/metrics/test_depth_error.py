import numpy as np
import pytest

from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.metrics.depth_error import MISSING, depth_error, disparity_error, nearest_pair
from tests.support.known_geometry import ring, sphere_depth

RIG = ring(8, (64, 48))
TRUTH = sphere_depth(RIG, 0, np.zeros(3), 0.6)
MASK = np.where(TRUTH > 0, 255, 0).astype(np.uint8)


def test_truth_has_no_error():
    error = depth_error(TRUTH, TRUTH, MASK, RIG, 0, range(8))
    assert error is not None
    assert error.epe == pytest.approx(0, abs=1e-9)
    assert error.one_pixel == 1
    assert error.pixels == (MASK > 127).sum()


def test_the_error_is_the_distance_of_the_projected_points_in_the_rectified_partner():
    """Definition by hand: both points of a pixel, seen by the second rectified camera, in px along the row."""
    pair = nearest_pair(RIG, 0, range(8))
    assert pair.views == (0, 1)
    wrong = np.where(TRUTH > 0, TRUTH * 1.03, 2.0)
    seen = [
        project(unproject(z, RIG.intrinsics[0], RIG.world_to_camera[0]), pair.intrinsics[1], pair.world_to_camera(1))[0]
        for z in (np.where(TRUTH > 0, TRUTH, 2.0), wrong)
    ]
    by_hand = np.abs(seen[0] - seen[1])[..., 0]
    np.testing.assert_allclose(disparity_error(wrong, TRUTH, pair)[TRUTH > 0], by_hand[TRUTH > 0], rtol=1e-9)


def test_a_missing_pixel_counts_sixteen_and_background_nothing():
    depth = TRUTH.copy()
    rows, columns = np.nonzero(TRUTH)
    depth[rows[::2], columns[::2]] = 0
    error = depth_error(depth, TRUTH, MASK, RIG, 0, range(8))
    assert error is not None
    assert error.epe == pytest.approx(MISSING * len(rows[::2]) / len(rows))
    assert error.one_pixel == pytest.approx(1 - len(rows[::2]) / len(rows))
    filled = np.where(TRUTH > 0, TRUTH, 9.0)
    assert depth_error(filled, TRUTH, MASK, RIG, 0, range(8)).epe == pytest.approx(0, abs=1e-9)


def test_soft_mask_pixels_below_the_threshold_are_not_measured():
    soft = np.where(TRUTH > 0, 127, 0).astype(np.uint8)
    assert depth_error(TRUTH, TRUTH, soft, RIG, 0, range(8)) is None


def test_what_cannot_be_measured_is_an_error():
    with pytest.raises(ValueError, match="only source view"):
        depth_error(TRUTH, TRUTH, MASK, RIG, 0, [0])
    with pytest.raises(ValueError, match="not finite"):
        depth_error(np.full_like(TRUTH, np.nan), TRUTH, MASK, RIG, 0, range(8))
