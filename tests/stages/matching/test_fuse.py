import numpy as np
import pytest

from posegaussian.stages.matching.fuse import FILLED, HULL, MATCHED, complete, fuse


def one(*pixels: tuple[float, float]) -> tuple[float, float]:
    """Fuse (depth, error) candidates of a single pixel; 100 px per 1/m, consistency 1.5 px."""
    depths = np.array([[[z]] for z, _ in pixels], np.float32)
    errors = np.array([[[e]] for _, e in pixels], np.float32)
    depth, confidence = fuse(depths, errors, np.full(len(pixels), 100.0), 1.5)
    return float(depth[0, 0]), float(confidence[0, 0])


def test_agreement_raises_confidence_and_contradiction_lowers_it():
    single, both, against = one((2.0, 0.0)), one((2.0, 0.0), (2.0, 0.1)), one((2.0, 0.0), (2.5, 0.1))
    assert single[0] == both[0] == against[0] == pytest.approx(2.0)
    assert both[1] > single[1] > against[1] >= MATCHED
    assert one((2.0, 0.0))[1] > one((2.0, 1.0))[1]


def test_the_mean_is_of_inverse_depths_and_does_not_depend_on_the_order():
    depth, _ = one((2.0, 0.5), (2.02, 0.5))
    assert depth == pytest.approx(2 / (1 / 2.0 + 1 / 2.02), rel=1e-6)
    assert one((2.0, 0.2), (2.01, 0.4)) == pytest.approx(one((2.01, 0.4), (2.0, 0.2)), rel=1e-6)


def test_without_a_consistent_candidate_there_is_nothing():
    assert one((2.0, 1.6), (2.1, np.inf), (0.0, np.inf)) == (0.0, 0.0)


def test_gaps_are_filled_within_the_hull_and_trusted_less():
    near, far = np.full((1, 4), 1.9, np.float32), np.full((1, 4), 2.05, np.float32)
    near[0, 3] = far[0, 3] = 0
    depth, confidence = complete(
        np.array([[2.2, 0, 0, 0]], np.float32), np.array([[0.9, 0, 0, 0]], np.float32), near, far
    )
    np.testing.assert_allclose(depth, [[2.2, 2.05, 2.05, 0]])
    np.testing.assert_allclose(confidence, [[0.9, FILLED, FILLED, 0]])
    alone, trust = complete(np.zeros((1, 4), np.float32), np.zeros((1, 4), np.float32), near, far)
    np.testing.assert_allclose(alone, near)
    np.testing.assert_allclose(trust, np.where(near > 0, HULL, 0).astype(np.float32))
    surface = np.where(near > 0, 1.95, 0).astype(np.float32)
    alone, trust = complete(np.zeros((1, 4), np.float32), np.zeros((1, 4), np.float32), near, far, surface)
    np.testing.assert_array_equal(alone, surface)
    np.testing.assert_allclose(trust, np.where(near > 0, HULL, 0).astype(np.float32))
