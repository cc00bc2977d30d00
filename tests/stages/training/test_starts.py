"""Starts are what they say: the hull, the truth, the truth off by so much, a relief of the truth's mean."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.training.config import Starts
from posegaussian.stages.training.starts import OFF, kind_drawn, off_by, relief_start, start_of
from tests.support.training_examples import ball

FRAME = {**ball(exact=False), "hull": 0.9 * ball(exact=False)["depth"]}
SENSITIVITY = 40.0


def test_kinds_come_by_their_shares() -> None:
    random = np.random.default_rng(0)
    kinds = [kind_drawn(Starts(matched=1, hull=2, noisy=0, truth=1), random) for _ in range(4000)]
    shares = {k: kinds.count(k) / len(kinds) for k in ("matched", "hull", "noisy", "truth")}
    # three standard errors of 4000 draws
    assert shares == {
        "matched": pytest.approx(0.25, abs=0.02),
        "hull": pytest.approx(0.5, abs=0.024),
        "noisy": 0,
        "truth": pytest.approx(0.25, abs=0.02),
    }
    with pytest.raises(ValueError, match="all shares of starts are 0"):
        Starts(matched=0, hull=0, noisy=0, truth=0)


@pytest.mark.parametrize("kind", ["matched", "hull", "noisy", "truth"])
def test_a_start_is_where_the_subject_is_and_nowhere_else(kind: str) -> None:
    found = start_of(FRAME, 0, kind, SENSITIVITY, np.random.default_rng(1))  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.depth > 0, FRAME["depth"][0] > 0)
    np.testing.assert_array_equal(found.confidence > 0, found.depth > 0)
    assert 0 <= found.confidence.min() <= found.confidence.max() <= 1
    assert np.isfinite(found.depth).all()


def test_the_truth_is_the_truth_and_noise_is_as_large_as_it_says() -> None:
    truth = FRAME["truth"][0]
    there = (truth > 0) & (FRAME["depth"][0] > 0)
    exact = start_of(FRAME, 0, "truth", SENSITIVITY, np.random.default_rng(2))
    np.testing.assert_array_equal(exact.depth[there], truth[there])
    off = []
    for seed in range(30):
        noisy = start_of(FRAME, 0, "noisy", SENSITIVITY, np.random.default_rng(seed))
        off.append(float(np.sqrt(np.mean((SENSITIVITY * (1 / noisy.depth[there] - 1 / truth[there])) ** 2))))
    assert max(off) < 3 * OFF[1]
    assert np.median(off) == pytest.approx(np.sqrt(OFF[0] * OFF[1]), rel=0.5), "even in the logarithm"


def test_a_change_of_inverse_depth_is_bounded() -> None:
    depth = np.array([[2.0, 2.0, 0.0, 2.0]], np.float32)
    found = off_by(depth, np.array([[0.05, 10.0, 1.0, -10.0]]))
    np.testing.assert_allclose(found, [[1 / 0.55, 1 / 0.6, 0, 1 / 0.4]], rtol=1e-6)


def test_a_relief_lies_where_the_truth_has_its_mean() -> None:
    mask, truth = FRAME["mask"][0], FRAME["truth"][0]
    found = relief_start(mask, truth, float(FRAME["intrinsics"][0, 0, 0]))
    both = (found.depth > 0) & (truth > 0)
    assert (1 / found.depth[both]).mean() == pytest.approx((1 / truth[both]).mean(), rel=1e-6)
    again = relief_start(mask, 3 * truth, float(FRAME["intrinsics"][0, 0, 0]))
    np.testing.assert_allclose(again.depth, 3 * found.depth, rtol=1e-6, err_msg="the shape knows no distance")
