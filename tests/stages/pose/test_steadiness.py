"""What joints and heatmaps are measured with is right."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.pose.heatmaps import draw
from posegaussian.stages.pose.jitter import measures, off_heatmaps
from tests.support.walking_skeleton import SKELETON, moving, scored


def test_a_joint_is_read_off_its_heatmap_to_a_twentieth_of_a_cell() -> None:
    at = np.random.default_rng(0).uniform(40, 88, (1, 17, 2))
    joints = np.concatenate([at, np.full((1, 17, 1), 0.9)], axis=-1)
    maps = draw(joints, np.full((1, 17), 8.0), (128, 128), (32, 32))
    assert np.abs(off_heatmaps(maps)[..., :2] - at).max() < 0.2  # cells are 4 px wide
    assert not off_heatmaps(np.zeros((2, 3, 8, 8), np.float16)).any()


def test_lag_error_and_jitter_of_what_is_known() -> None:
    truth = moving(30)
    late = scored(0.7 * truth[1:] + 0.3 * truth[:-1])
    said = measures(late, truth[1:])
    assert said["lag frames"] == pytest.approx(0.3, abs=0.01)
    assert measures(scored(truth + np.array([0.003, 0, 0.004])), truth) == pytest.approx(
        {"known": 1, "MPJPE mm": 5, "median mm": 5, "95 % mm": 5, "jitter mm": 0, "lag frames": 0}, abs=0.2
    )
    shaken = scored(truth)
    shaken[::2, :, 0] += 0.001
    assert measures(shaken, truth)["jitter mm"] == pytest.approx(2.0)
    assert (
        measures(scored(np.repeat(SKELETON[None], 5, axis=0)), np.repeat(SKELETON[None], 5, axis=0))["lag frames"]
        is None
    )
    shaken[4, 2] = 0
    assert measures(shaken, truth)["known"] == pytest.approx(1 - 1 / (30 * 17))
