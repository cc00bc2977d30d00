"""Jitter and motion of joints against known noise and speed."""

import numpy as np
import pytest

from posegaussian.stages.survey.algorithms.motion import RUN, jitter_and_motion, run_starts


def runs(count: int, noise: float, velocity: float, seed: int = 0) -> np.ndarray:
    """[count, 4, 17, 3] joints that move at constant speed, px a frame, with white noise on each coordinate."""
    rng = np.random.default_rng(seed)
    t = np.arange(RUN)[None, :, None]
    angle = rng.uniform(0, 2 * np.pi, (count, 1, 17))
    x = (
        np.stack([velocity * t * np.cos(angle), velocity * t * np.sin(angle)], axis=-1)
        + 100.0
        + rng.normal(0, noise, (count, RUN, 17, 2))
    )
    return np.concatenate([x, np.ones((*x.shape[:-1], 1))], axis=-1)


@pytest.mark.parametrize(("noise", "velocity"), [(1.0, 0.0), (1.0, 4.0), (0.3, 2.0), (2.0, 10.0)])
def test_noise_and_speed_are_told_apart(noise: float, velocity: float) -> None:
    jitter, motion, compared = jitter_and_motion(runs(25, noise, velocity))
    assert compared == 25 * 17
    # 425 third differences: their median is known to 5 %.
    # The trimmed twentieth of the steps takes up to a tenth of the speed.
    assert jitter == pytest.approx(noise, rel=0.12)
    assert motion == pytest.approx(velocity, rel=0.12, abs=0.5 * noise)


def test_smooth_acceleration_is_no_jitter() -> None:
    x = runs(10, 0.0, 3.0)
    x[..., 0] += 0.5 * np.arange(RUN)[None, :, None] ** 2
    jitter, motion, _ = jitter_and_motion(x)
    assert jitter < 1e-9, "a third difference of a parabola is 0"
    assert motion > 2


def test_a_joint_that_jumps_now_and_then_changes_neither() -> None:
    x = runs(25, 1.0, 2.0)
    x[::25, 2, :, :2] += 200
    jitter, motion, _ = jitter_and_motion(x)
    assert jitter == pytest.approx(1.0, rel=0.15)
    assert motion < 3.5


def test_unknown_joints_do_not_count() -> None:
    x = runs(5, 1.0, 1.0)
    x[:, 1, :10, 2] = 0.1
    assert jitter_and_motion(x)[2] == 5 * 7
    assert jitter_and_motion(np.zeros((5, RUN, 17, 3))) == (0.0, 0.0, 0)
    assert jitter_and_motion(np.zeros((0, RUN, 17, 3))) == (0.0, 0.0, 0)


def test_runs_are_evenly_spaced_frames_and_each_counts_once() -> None:
    numbers = np.arange(100)
    found = run_starts(numbers, np.array([0, 50, 98, 99]))
    assert [r.tolist() for r in found] == [[0, 1, 2, 3], [50, 51, 52, 53], [96, 97, 98, 99]]
    every_second = np.arange(1, 21, 2)
    assert run_starts(every_second, every_second[:1])[0].tolist() == [1, 3, 5, 7]
    with_a_hole = np.array([0, 1, 2, 5, 6, 7, 8])
    assert [r.tolist() for r in run_starts(with_a_hole, with_a_hole)] == [[5, 6, 7, 8]]
    assert run_starts(np.arange(3), np.arange(3)) == []
