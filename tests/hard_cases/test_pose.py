"""The catalogue of joints and of their smoothing, P1-P8; tests/stages/smoothing states the laws at length."""

import math

import numpy as np
import pytest

from posegaussian.stages.geometry.triangulation import triangulate
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.stage import STAGE as POSE
from posegaussian.stages.smoothing.filters import blend, stillness
from tests.hard_cases.cases_pose import (
    HIDDEN,
    OUTSIDE,
    WEIGHT,
    behind,
    bell,
    filmed,
    frames_shown,
    hidden_error,
    joint,
    jump,
    mended_error,
    pairwise_plain,
    swapped,
    turned_round,
    twin,
)
from tests.hard_cases.catalogue import apart
from tests.stages.smoothing.test_smoothing import HALF, METHODS, noisy, smooth, track
from tests.support.memory_inputs import run_stage
from tests.support.walking_skeleton import Joints2D, pixels, ring, roles, walk


def test_p1_nobody_is_nowhere_in_every_step() -> None:
    empty, unknown = np.zeros((2, 3, 5, 5), np.float16), np.zeros((2, 3, 3))
    assert not blend(empty, np.zeros((2, 3)), np.full(3, 0.5), np.ones(3)).any()
    assert (stillness(empty, unknown, 1.0, 4) == 1).all()
    assert not triangulate(ring(4), np.zeros((4, 17, 3)), 0.3, 0.02).any()


@pytest.mark.parametrize(("u", "v"), [*OUTSIDE, (np.nextafter(0, -1), 20.0), (64.0, 20.0)])
def test_p2_outside_there_is_no_mass(u: float, v: float) -> None:
    assert not joint(u, v).any()


@pytest.mark.parametrize("u", [0.0, np.nextafter(64, 0)])
def test_p2_on_the_border_half_of_the_mass_is_left(u: float) -> None:
    assert joint(u).sum() == pytest.approx(joint(32.0).sum() / 2, rel=0.01)


@pytest.mark.parametrize("sigma", [0.0, 1e-30, 1e-3, 1.0])
def test_p3_a_narrow_peak_is_as_wide_as_half_a_cell(sigma: float) -> None:
    np.testing.assert_array_equal(joint(29.3, 21.1, sigma=sigma), joint(29.3, 21.1, sigma=2.0))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("omega", [0.0, 0.5, 1.0])
def test_p4_the_first_frame_passes_with_any_weight(method: str, omega: float) -> None:
    arrays = noisy(frames=3)
    np.testing.assert_array_equal(smooth(arrays, method=method, omega=omega)[0], arrays["pose/heatmaps"][0])


@pytest.mark.parametrize("method", METHODS)
def test_p4_a_frame_that_comes_twice_changes_nothing_of_a_joint_at_rest(method: str) -> None:
    once, twice = (smooth(track([66.0] * n), method=method, omega=0.5) for n in (3, 4))
    np.testing.assert_array_equal(once[-1], twice[-1])


def test_p5_the_papers_equation_shows_a_twin_and_says_so() -> None:
    """`pairwise` is what the paper defines; who fears swaps chooses `adaptive`, which is why it exists."""
    assert twin(smooth(swapped(), method="pairwise", omega=0.5)) == pytest.approx(
        twin(pairwise_plain(swapped()["pose/heatmaps"].astype(float), 0.5)), abs=HALF
    )


def test_p5_without_the_mender_every_method_but_adaptive_shows_the_twin() -> None:
    """The same capture with the sides as the detector named them: what the mender takes away."""
    _, right = filmed(lambda joints: joints)
    cameras, points = ring(6, size=96), walk(9)
    given = turned_round(pixels(cameras, points))
    # all views agree on the wrong side in frame 4, so that a frame by itself can tell nothing
    alone = run_stage(
        POSE,
        PoseParams(bridge=0),
        {},
        cameras,
        roles(cameras),
        9,
        sources={"joints": Joints2D.single(given)},
        facts=frozenset({"joints2d"}),
    )
    for method in ("pairwise", "recurrent"):
        assert apart(smooth(alone, method=method, omega=0.5)[5], smooth(right, method=method, omega=0.5)[5]) > 0.2
    assert mended_error() == 0


@pytest.mark.parametrize("truncation", [1, 2, 5])
def test_p6_the_old_place_shows_for_as_many_frames_as_said(truncation: int) -> None:
    shown = {m: frames_shown(smooth(jump(), method=m, omega=WEIGHT, truncation=truncation)) for m in METHODS}
    assert shown == {"adaptive": 0, "pairwise": 1, "recurrent": truncation}


@pytest.mark.parametrize("method", METHODS)
def test_p7_a_missing_frame_keeps_place_and_height(method: str) -> None:
    gap = smooth(track([66.0, 66.0, 66.0], [0.8, 0.0, 0.8]), method=method, omega=0.8)[1, 0, 0].astype(np.float64)
    expected = 0.8 * np.exp(-((np.arange(32) * 4 + 2 - 66.0) ** 2) / (2 * 8.0**2))
    np.testing.assert_allclose(gap.max(axis=0), np.where(expected < 1e-3, 0, expected), atol=HALF)


def test_p8_a_hidden_joint_is_bridged_with_a_lower_score() -> None:
    points, found = filmed(behind)
    assert hidden_error() < 1.0
    score = found["pose/joints3d"][:, 9, 3]
    assert (np.diff(score[2:5]) < 0).all()
    assert score[[0, 1, 2, 6, 7, 8]] == pytest.approx(1.0)
    unseen = run_stage(
        POSE,
        PoseParams(bridge=0),
        {},
        ring(6, size=96),
        roles(ring(6, size=96)),
        9,
        sources={"joints": Joints2D.single(behind(pixels(ring(6, size=96), points)))},
        facts=frozenset({"joints2d"}),
    )
    assert not unseen["pose/joints3d"][HIDDEN, 9].any()


def test_p7_a_doubtful_detection_moves_a_sure_one_little() -> None:
    """Weights are scores: at 0.05 against 1 the joint stays where it was sure to be."""
    out = smooth(track([66.0, 86.0], [1.0, 0.05]), omega=0.8)[1, 0, 0].astype(np.float64)
    assert out[:, 16].max() > 3 * out[:, 21].max()
    assert bell(30.0).max() <= 1
    assert math.isclose(out.max(), 1.0, abs_tol=0.2)
