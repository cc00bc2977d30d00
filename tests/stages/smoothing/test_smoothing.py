"""Laws of temporal pose smoothing: identity, bounds, the paper's equation,
no ghost limb, partitions, lag and step response."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.io import Block, Views
from posegaussian.stages.pose.heatmaps import draw
from posegaussian.stages.smoothing.filters import blend, stillness, taps
from posegaussian.stages.smoothing.params import SmoothingParams
from posegaussian.stages.smoothing.run import check
from posegaussian.stages.smoothing.stage import STAGE
from posegaussian.storage.model.cameras import Rig
from tests.support.memory_inputs import run_stage

METHODS = ("pairwise", "recurrent", "adaptive")
SIGMA, PIXELS, CELLS = 8.0, 128, 32
HALF = 1e-3  # half a unit of float16 below 1, once for the input and once for the output


def rig(views: int) -> Rig:
    return Rig(
        tuple(f"cam{v}" for v in range(views)),
        np.tile(np.eye(3), (views, 1, 1)),
        np.zeros((views, 8)),
        np.tile(np.eye(4), (views, 1, 1)),
        np.full((views, 2), PIXELS),
    )


def encode(joints: np.ndarray) -> dict[str, np.ndarray]:
    """The two arrays of the pose stage from joints [F, V, 17, 3]."""
    sigma = np.full(joints.shape[:-1], SIGMA)
    maps = np.stack(
        [draw(joints[:, v], sigma[:, v], (PIXELS, PIXELS), (CELLS, CELLS)) for v in range(joints.shape[1])], axis=1
    )
    return {"pose/joints2d": joints.astype(np.float32), "pose/heatmaps": maps}


def smooth(arrays: dict[str, np.ndarray], length: int | None = None, **settings: Any) -> np.ndarray:
    frames, views = arrays["pose/joints2d"].shape[:2]
    r = rig(views)
    params = SmoothingParams(**settings)
    out = run_stage(STAGE, params, arrays, r, Views(r.names, tuple(range(views)), ()), frames, length)[
        "smoothing/heatmaps"
    ]
    assert check(Block("smoothing/heatmaps", out, 0), params) == []
    return out


def noisy(frames: int = 9, views: int = 2, seed: int = 0) -> dict[str, np.ndarray]:
    """Joints that wander, jump, go missing and leave the picture."""
    rng = np.random.default_rng(seed)
    joints = np.empty((frames, views, 17, 3))
    joints[..., :2] = rng.uniform(20, 108, (1, views, 17, 2)) + rng.normal(0, 6, (frames, views, 17, 2)).cumsum(0)
    joints[..., 2] = np.where(rng.random((frames, views, 17)) < 0.25, 0, rng.uniform(0.1, 1, (frames, views, 17)))
    joints[joints[..., 2] == 0] = 0
    return encode(joints)


def track(positions: list[float], scores: list[float] | None = None) -> dict[str, np.ndarray]:
    """One view whose 17 joints all move along x, on cell centres' height."""
    joints = np.zeros((len(positions), 1, 17, 3))
    joints[..., 0] = np.array(positions)[:, None, None]
    joints[..., 1] = 66.0
    joints[..., 2] = np.array(scores or [1.0] * len(positions))[:, None, None]
    return encode(joints)


def peaks(heatmap: np.ndarray) -> int:
    """Local maxima over 3 x 3 cells; of equal neighbours the first counts."""
    padded = np.pad(heatmap.astype(np.float64), 1)
    around = [padded[i : i + CELLS, j : j + CELLS] for i in range(3) for j in range(3)]
    before, after = np.stack(around[:4]).max(0), np.stack(around[5:]).max(0)
    return int(((heatmap > 0.02) & (heatmap > before) & (heatmap >= after)).sum())


@pytest.mark.parametrize("method", METHODS)
def test_omega_one_is_the_identity_bit_by_bit(method: str) -> None:
    arrays = noisy()
    assert smooth(arrays, method=method, omega=1.0).tobytes() == arrays["pose/heatmaps"].tobytes()


@pytest.mark.parametrize("method", METHODS)
def test_the_first_frame_and_a_still_scene_pass(method: str) -> None:
    arrays = noisy()
    np.testing.assert_array_equal(smooth(arrays, method=method, omega=0.3)[0], arrays["pose/heatmaps"][0])
    still = {k: np.repeat(v[:1], 5, axis=0) for k, v in noisy(seed=7).items()}
    np.testing.assert_allclose(smooth(still, method=method, omega=0.3), still["pose/heatmaps"], atol=HALF)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("omega", [0.0, 0.4, 0.8, 1.0])
def test_values_stay_below_the_largest_score_of_the_window(method: str, omega: float) -> None:
    arrays = noisy(seed=1)
    out = smooth(arrays, method=method, omega=omega, truncation=3).astype(np.float64)
    scores = arrays["pose/joints2d"][..., 2]
    for t in range(len(out)):
        past = 3 if method == "recurrent" else 1
        bound = scores[max(0, t - past) : t + 1].max(0)[..., None, None]
        assert (out[t] <= bound + HALF).all()
        assert (out[t] >= 0).all()
    assert not ((out > 0) & (out < 1e-3)).any()


def test_equal_scores_give_the_papers_equation() -> None:
    arrays = noisy(seed=2)
    arrays["pose/joints2d"][..., 2] = 0.7
    arrays = encode(arrays["pose/joints2d"].astype(np.float64))
    h = arrays["pose/heatmaps"].astype(np.float64)
    expected = h.copy()
    expected[1:] = 0.8 * h[1:] + 0.2 * h[:-1]
    expected[expected < 1e-3] = 0
    np.testing.assert_allclose(smooth(arrays, omega=0.8), expected, atol=HALF)


def test_unequal_scores_follow_the_weighted_equation() -> None:
    arrays = noisy(seed=3)
    h, s, w = (
        arrays["pose/heatmaps"].astype(np.float64),
        arrays["pose/joints2d"][..., 2].astype(np.float64)[..., None, None],
        0.6,
    )
    weight = w * s[1:] + (1 - w) * s[:-1]
    expected = h.copy()
    expected[1:] = np.maximum(s[1:], s[:-1]) * (w * h[1:] + (1 - w) * h[:-1]) / np.where(weight > 0, weight, 1)
    np.testing.assert_allclose(smooth(arrays, omega=w), expected, atol=2 * HALF)  # the floor of 1e-3 among them


def test_recurrent_is_the_recursion_started_at_its_truncation() -> None:
    arrays, w, truncation = noisy(frames=8, seed=4), 0.5, 3
    h, s = (
        arrays["pose/heatmaps"].astype(np.float64),
        arrays["pose/joints2d"][..., 2].astype(np.float64)[..., None, None],
    )
    found = smooth(arrays, method="recurrent", omega=w, truncation=truncation)
    for t in range(8):
        start = max(0, t - truncation)
        mass, score, out = h[start], s[start], h[start]
        for k in range(start + 1, t + 1):
            amplitude = np.maximum(s[k], score)
            mass, score = w * h[k] + (1 - w) * mass, w * s[k] + (1 - w) * score
            out = amplitude * mass / np.where(score > 0, score, 1)
        np.testing.assert_allclose(found[t], out, atol=2 * HALF)


def test_pairwise_is_recurrent_with_one_frame_of_past() -> None:
    arrays = noisy(seed=5)
    np.testing.assert_array_equal(
        smooth(arrays, omega=0.6), smooth(arrays, method="recurrent", omega=0.6, truncation=1)
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("truncation", [1, 4])
def test_partitions_of_every_length_give_the_same_bytes(method: str, truncation: int) -> None:
    arrays = noisy(frames=7, seed=6)
    whole = smooth(arrays, method=method, omega=0.5, truncation=truncation)
    for length in range(1, 7):
        assert smooth(arrays, length, method=method, omega=0.5, truncation=truncation).tobytes() == whole.tobytes()


def test_a_fast_kick_leaves_a_ghost_with_pairwise_and_none_with_adaptive() -> None:
    kick = track([20.0, 60.0, 100.0])  # 5 sigma a frame
    assert peaks(kick["pose/heatmaps"][1, 0, 0]) == 1
    assert peaks(smooth(kick, omega=0.5)[1, 0, 0]) == 2
    assert peaks(smooth(kick, method="recurrent", omega=0.5)[2, 0, 0]) == 3
    adaptive = smooth(kick, method="adaptive", omega=0.5)
    np.testing.assert_array_equal(adaptive, kick["pose/heatmaps"])


@pytest.mark.parametrize("sigmas", [0.25, 0.5, 1.0, 1.5, 1.9, 2.5, 4.0])
def test_adaptive_never_shows_a_second_peak(sigmas: float) -> None:
    for limit in (0.5, 1.0, 2.0):  # two equal bells closer than 2 sigma have one top
        out = smooth(track([40.0, 40.0 + sigmas * SIGMA]), method="adaptive", omega=0.5, speed=limit)
        assert peaks(out[1, 0, 0]) == 1


def test_adaptive_is_pairwise_at_rest_and_goes_over_continuously() -> None:
    rest = track([50.0, 50.0, 50.0], [0.5, 0.9, 0.4])
    np.testing.assert_array_equal(smooth(rest, method="adaptive", omega=0.4), smooth(rest, omega=0.4))
    moved = [
        smooth(track([50.0, 50.0 + d], [0.9, 0.5]), method="adaptive", omega=0.5)[1, 0, 0].astype(np.float64)
        for d in np.linspace(0, 10, 41)
    ]
    steps = [np.abs(b - a).max() for a, b in pairwise(moved)]
    assert max(steps) < 0.05  # a quarter of a pixel changes no cell by more, not even at the limit of 8 px


def test_a_missing_frame_does_not_halve_the_peak() -> None:
    gap = track([66.0, 66.0, 66.0, 66.0], [0.8, 0.0, 0.8, 0.8])
    for method in METHODS:
        out = smooth(gap, method=method, omega=0.8).astype(np.float64)
        np.testing.assert_allclose(out.max(axis=(2, 3, 4))[:, 0], 0.8, atol=HALF)


def test_a_joint_that_left_the_picture_leaves_no_ghost_with_adaptive() -> None:
    gone = track([126.0, 130.0])  # half a sigma across the border
    assert smooth(gone, omega=0.8)[1].any()  # the paper's equation shows it a frame longer
    assert not smooth(gone, method="adaptive", omega=0.8)[1].any()
    come = track([-2.0, 2.0])
    np.testing.assert_array_equal(smooth(come, method="adaptive", omega=0.8), come["pose/heatmaps"])


def test_left_and_right_that_swap_leave_no_twin_with_adaptive() -> None:
    joints = np.tile(np.array([40.0, 66.0, 1.0]), (2, 1, 17, 1))
    joints[0, 0, 1::2, 0] = joints[1, 0, 0::2, 0] = 90.0
    out = smooth(encode(joints), method="adaptive", omega=0.5)[1, 0]
    assert [peaks(j) for j in out] == [1] * 17


def centroid(heatmaps: np.ndarray) -> np.ndarray:
    """[F] mean x of the first joint's mass, px."""
    mass = heatmaps[:, 0, 0].astype(np.float64).sum(axis=1)
    return (mass * (4 * np.arange(CELLS) + 2)).sum(-1) / mass.sum(-1)


@pytest.mark.parametrize("omega", [0.5, 0.8])
def test_lag_at_constant_speed_is_the_documented_one(omega: float) -> None:
    speed = 3.0
    moving = track([30.0 + speed * t for t in range(14)])
    behind = {
        m: (
            (centroid(moving["pose/heatmaps"]) - centroid(smooth(moving, method=m, omega=omega, truncation=4)))[-1]
            / speed
        )
        for m in METHODS
    }
    assert behind["pairwise"] == pytest.approx(1 - omega, abs=0.01)
    assert behind["recurrent"] == pytest.approx(sum((1 - omega) ** k for k in range(1, 5)), abs=0.01)
    calm = 1 - speed / SIGMA
    # sigma is measured from the map, without its tail
    assert behind["adaptive"] == pytest.approx((1 - omega) * calm, abs=0.02)


def test_step_response_is_the_documented_one() -> None:
    step = track([30.0] * 5 + [98.0] * 6)
    new = slice(16, CELLS)
    for method, omega in (("pairwise", 0.5), ("recurrent", 0.5)):
        out = smooth(step, method=method, omega=omega, truncation=4)[:, 0, 0].astype(np.float64)
        share = out[:, :, new].sum(axis=(1, 2)) / out.sum(axis=(1, 2))
        past = 4 if method == "recurrent" else 1
        expected = [0.0] * 5 + [1 - (1 - omega) ** (k + 1) if k < past else 1.0 for k in range(6)]
        np.testing.assert_allclose(share, expected, atol=0.01)
    np.testing.assert_array_equal(smooth(step, method="adaptive", omega=0.5), step["pose/heatmaps"])


@pytest.mark.parametrize("past", [0, 1, 5])
def test_taps_sum_to_one_and_forget(past: int) -> None:
    for omega in (0.0, 0.3, 0.8, 1.0):
        t = taps(omega, past)
        assert len(t) == past + 1
        assert t.sum() == pytest.approx(1)
        assert (t >= 0).all()
    np.testing.assert_allclose(taps(0.8, 1), [0.8, 0.2])


def test_omega_zero_with_nothing_before_keeps_the_current_frame() -> None:
    late = track([66.0, 66.0], [0.0, 0.6])
    np.testing.assert_allclose(smooth(late, omega=0.0)[1], late["pose/heatmaps"][1], atol=HALF)


def test_stillness_measures_speed_in_sigmas() -> None:
    arrays = track([50.0, 50.0 + 0.3 * SIGMA])
    calm = stillness(arrays["pose/heatmaps"][:, 0], arrays["pose/joints2d"][:, 0], 1.0, 4)
    np.testing.assert_allclose(calm, 0.7, atol=0.01)
    arrays["pose/joints2d"][0, 0, :5, 2] = 0  # unknown before: no speed
    assert (stillness(arrays["pose/heatmaps"][:, 0], arrays["pose/joints2d"][:, 0], 1.0, 4)[:5] == 1).all()


def test_blend_of_equal_frames_is_the_frame() -> None:
    h = np.random.default_rng(0).uniform(0.1, 0.6, (4, 3, 5, 5)).astype(np.float16)
    h[:] = h[0]
    out = blend(h, np.full((4, 3), 0.6), np.full(3, 0.3), np.ones(3))
    np.testing.assert_allclose(out, h[0], rtol=1e-6)


def test_check_refuses_values_outside_the_bounds() -> None:
    for value in (np.nan, -0.1, 1.5):
        data = np.zeros((1, 17, 2, 2), np.float16)
        data[0, 0, 0, 0] = value
        with pytest.raises(ValueError, match=r"smoothing/heatmaps of view 3: 1 of 68 values lie outside 0..1"):
            check(Block("smoothing/heatmaps", data, 3), SmoothingParams())
