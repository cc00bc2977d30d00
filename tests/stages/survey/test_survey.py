"""The survey's sample and plate against numpy."""

import numpy as np
import pytest

from posegaussian.stages.contract.io import Block, Views
from posegaussian.stages.simulator.subjects.capsule_person import capture_person, ring
from posegaussian.stages.survey.algorithms.body_mask import people_cover
from posegaussian.stages.survey.algorithms.plate import UNKNOWN, median_and_spread
from posegaussian.stages.survey.algorithms.sample import sample_numbers
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.stages.survey.run import check
from posegaussian.stages.survey.stage import STAGE
from tests.support.frame_readers import Pictures
from tests.support.memory_inputs import run_stage


def _survey(pictures: list[list[np.ndarray]], sample: int) -> dict[str, np.ndarray]:
    rig = ring(len(pictures), 16, 0)
    out: dict[str, np.ndarray] = {}
    for view in range(len(pictures)):
        part = run_stage(
            STAGE,
            SurveyParams(sample=sample),
            {},
            rig,
            Views(rig.names, (0, 1), ()),
            len(pictures[0]),
            view=view,
            sources={"pictures": Pictures(pictures)},
            facts=frozenset({"survey/plate", "survey/spread"}),
        )
        for name, data in part.items():
            out.setdefault(name, np.zeros_like(data))[view] = data[view]
    return out


@pytest.mark.parametrize("n", [3, 7, 25])
def test_median_and_spread_are_numpy_s(n: int) -> None:
    stack = np.random.default_rng(n).integers(0, 256, (n, 13, 17, 3), dtype=np.uint8)
    plate, spread = median_and_spread(stack, np.zeros(stack.shape[:3], np.uint8))
    median = np.median(stack, axis=0)
    np.testing.assert_array_equal(plate, median)
    np.testing.assert_array_equal(spread, np.median(np.abs(stack - median), axis=0).max(axis=-1))


def test_an_even_sample_takes_the_lower_middle_value() -> None:
    stack = np.array([10, 40, 20, 30], np.uint8)[:, None, None, None].repeat(3, -1)
    plate, spread = median_and_spread(stack, np.zeros(stack.shape[:3], np.uint8))
    assert plate.ravel().tolist() == [20, 20, 20]
    assert spread.item() == 10


def test_covered_samples_do_not_count_and_what_was_never_seen_is_marked() -> None:
    rng = np.random.default_rng(1)
    stack = rng.integers(0, 256, (9, 10, 12, 3), dtype=np.uint8)
    covered = (rng.random((9, 10, 12)) < 0.5).astype(np.uint8)
    plate, spread = median_and_spread(stack, covered)
    for y in range(10):
        for x in range(12):
            shown = stack[covered[:, y, x] == 0, y, x]
            if len(shown) < 3:
                assert spread[y, x] == UNKNOWN
                shown = stack[:, y, x]
            np.testing.assert_array_equal(plate[y, x], np.sort(shown, axis=0)[(len(shown) - 1) // 2])
    assert (spread == UNKNOWN).any()


def test_cover_is_around_limbs_and_scales_with_the_person() -> None:
    person = capture_person(1, 96, 1, 0, "stand")
    joints = person.joints2d[0]
    cover = people_cover(joints, "coco17", (96, 96), 0.08)
    inside = person.mask[0, 0] > 127
    # Joints end at wrists, ankles and eyes; hands, shoes and crown stick out by little more than the margin.
    assert cover[inside].mean() > 0.97
    assert cover.sum() < 3 * inside.sum()
    unknown = joints.copy()
    unknown[..., 2] = 0
    assert not people_cover(unknown, "coco17", (96, 96), 0.08).any()
    assert not people_cover(np.zeros((0, 17, 3)), "coco17", (96, 96), 0.08).any()
    doubled = people_cover(joints * [2, 2, 1], "coco17", (192, 192), 0.08)
    assert doubled.sum() / cover.sum() == pytest.approx(4.0, rel=0.1)
    assert not people_cover(joints + np.array([1e7, 0, 0]), "coco17", (96, 96), 0.08).any(), "far outside the picture"


def test_sample_is_even_recorded_and_padded_and_views_of_other_sizes_too() -> None:
    rng = np.random.default_rng(0)
    views = [
        list(rng.integers(0, 256, (20, 12, 16, 3), dtype=np.uint8)),
        list(rng.integers(0, 256, (3, 18, 10, 3), dtype=np.uint8)),
    ]
    out = _survey(views, 5)
    np.testing.assert_array_equal(out["survey/sample"], [[0, 5, 10, 14, 19], [0, 1, 2, -1, -1]])
    assert out["survey/plate"].shape == (2, 18, 16, 3)
    np.testing.assert_array_equal(
        out["survey/plate"][0, :12], np.median(np.stack(views[0])[[0, 5, 10, 14, 19]], axis=0)
    )
    np.testing.assert_array_equal(out["survey/plate"][1, :, :10], np.median(np.stack(views[1]), axis=0))
    assert not out["survey/plate"][0, 12:].any()
    assert not out["survey/spread"][1, :, 10:].any()


def test_sample_covers_first_and_last_frame() -> None:
    numbers = np.arange(100, 700, 2)
    sample = sample_numbers(numbers, 25)
    assert (sample[0], sample[-1], len(sample)) == (100, 698, 25)
    assert set(sample) <= set(numbers)
    assert np.ptp(np.diff(sample)) <= 2


def test_check_says_when_a_plate_cannot_be_trusted() -> None:
    params = SurveyParams()
    assert "only 2 frames" in check(Block("survey/sample", np.array([3, 9, -1]), 0), params)[0]
    assert check(Block("survey/sample", np.arange(25), 0), params) == []
    assert check(Block("survey/sample", np.array([3, -1, -1]), 0), params) == [], "a still has no second frame"
    assert "not static" in check(Block("survey/spread", np.full((8, 8), 30, np.uint8), 1), params)[0]
    assert check(Block("survey/spread", np.full((8, 8), 2, np.uint8), 1), params) == []
    clean = np.zeros((12, 16), np.uint8)  # no noise: whoever walks, or a screen behind them, alone changes
    clean[2:9, 3:7] = clean[10, 14] = 40
    assert check(Block("survey/spread", clean, 1), params) == [], "most of the picture never changes"
    smaller = np.pad(np.full((6, 7), 30, np.uint8), ((0, 6), (0, 9)))
    assert "not static" in check(Block("survey/spread", smaller, 1), params)[0], "padding is no part of the picture"
    assert check(Block("survey/spread", np.zeros((8, 8), np.uint8), 1), params) == []
