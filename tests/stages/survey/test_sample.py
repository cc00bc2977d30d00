"""What the survey looks at: the frames that are worked on, each decoded once whatever is asked of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.consistency import OFFSETS, change_across
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.survey.algorithms.outlines import change_at_outline
from posegaussian.stages.survey.algorithms.sample import (
    FEWEST,
    compared_numbers,
    of_somebody,
    sample_numbers,
    worked_numbers,
)
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.stages.survey.run import FEW, run
from posegaussian.stages.survey.stage import STAGE
from tests.support.frame_readers import Joints, Pictures
from tests.support.memory_inputs import MemoryInputs, run_stage

VIEWS, FRAMES = 3, 12
EVERY = frozenset(f"survey/{name}" for name in ("plate", "spread", "surface", "outlines", "light", "noise")) | {
    "joints2d",
    "masks",
}


class Counted(Pictures):
    def __init__(self, views: Sequence[Sequence[np.ndarray]]) -> None:
        super().__init__([list(v) for v in views])
        self.decoded: Counter[tuple[int, int]] = Counter()

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        for n, picture in zip(numbers, super().read(view, numbers), strict=True):
            self.decoded[view, int(n)] += 1
            yield picture


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(VIEWS, 48, FRAMES, 0, "kick")


def sources(person: PersonCapture) -> dict[str, object]:
    """Readers over the person's pictures, masks and the first view's joints."""
    seen = [[np.ascontiguousarray(p) for p in person.color[:, v]] for v in range(VIEWS)]
    return {
        "pictures": Counted(seen),
        "masks": Pictures([list(person.mask[:, v]) for v in range(VIEWS)]),
        "joints": Joints(person.joints2d[:, 0]),
    }


def test_a_picture_is_decoded_once_for_all_measures(person: PersonCapture) -> None:
    given = sources(person)
    for view in range(VIEWS):
        run_stage(STAGE, SurveyParams(), {}, person.rig, person.views, FRAMES, view=view, sources=given, facts=EVERY)
    decoded = given["pictures"].decoded  # type: ignore[attr-defined]
    assert set(decoded) == {(v, n) for v in range(VIEWS) for n in range(FRAMES)}
    twice = {key for key, times in decoded.items() if times > 1}
    assert all(v > 0 for v, _ in twice), "only what an earlier view compared itself with"
    assert len(twice) <= 2 * (VIEWS - 1)
    assert max(decoded.values()) == 2, "features are kept for the next view's task"


def test_measures_look_at_the_frames_that_are_worked_on_and_the_plate_at_all(person: PersonCapture) -> None:
    given = sources(person)
    inputs = MemoryInputs(
        STAGE,
        SurveyParams(),
        {},
        person.rig,
        person.views,
        range(3, 9),
        FRAMES,
        view=2,
        sources=given,
        facts=EVERY - {"survey/plate", "survey/spread"},
    )
    blocks = {b.array: b.data for b in run(inputs, SurveyParams())}  # type: ignore[arg-type]
    assert [n for n in blocks["survey/sample"] if n >= 0] == list(range(3, 9))
    few = {(2, n) for n in sample_numbers(np.arange(3, 9), FEW)}
    assert {(2, 3), (2, 8)} < few
    assert set(given["pictures"].decoded) == few  # type: ignore[attr-defined]
    inputs = inputs.but(facts=inputs.facts | {"survey/plate"})
    blocks = {b.array: b.data for b in run(inputs, SurveyParams())}  # type: ignore[arg-type]
    assert [n for n in blocks["survey/background"] if n >= 0] == list(range(FRAMES))


@pytest.mark.parametrize(
    ("worked", "expected"),
    [(range(2), range(5)), (range(7, 8), range(5, 10)), (range(11, 12), range(7, 12)), (range(2, 9), range(2, 9))],
)
def test_around_fewer_than_five_frames_their_neighbours_are_looked_at_too(
    person: PersonCapture, worked: range, expected: range
) -> None:
    inputs = MemoryInputs(
        STAGE, SurveyParams(), {}, person.rig, person.views, worked, FRAMES, view=0, sources=sources(person)
    )
    np.testing.assert_array_equal(worked_numbers(inputs, 0), expected)  # type: ignore[arg-type]
    assert len(expected) >= FEWEST


@pytest.mark.parametrize("there", [range(FRAMES), range(8, 12), range(4, 8), range(0)])
def test_views_are_compared_in_frames_that_show_somebody(person: PersonCapture, there: range) -> None:
    given = sources(person)
    masks = [[person.mask[n, v] * (n in there) for n in range(FRAMES)] for v in range(VIEWS)]
    given["masks"] = Pictures([list(m) for m in masks])
    facts = frozenset({"survey/surface", "masks"})
    run_stage(STAGE, SurveyParams(), {}, person.rig, person.views, FRAMES, view=0, sources=given, facts=facts)
    compared = {n for _, n in given["pictures"].decoded}  # type: ignore[attr-defined]
    usual = set(compared_numbers(np.arange(FRAMES)).tolist())
    assert len(compared) == 2
    assert compared <= set(there or range(FRAMES))
    assert compared == usual or not usual <= set(there)
    assert compared == usual or there


def test_without_masks_all_sampled_frames_may_be_compared() -> None:
    inputs: Any = SimpleNamespace(facts=frozenset({"joints2d"}))
    np.testing.assert_array_equal(of_somebody(inputs, np.arange(9)), np.arange(9))


def test_offsets_in_the_part_around_the_subject_are_those_of_the_whole_picture() -> None:
    picture, mask = np.full((300, 260, 3), 40, np.uint8), np.zeros((300, 260), np.uint8)
    cv2.ellipse(picture, (110, 140), (30, 50), 0, 0, 360, (200, 150, 90), -1)
    cv2.ellipse(mask, (110, 140), (32, 52), 0, 0, 360, 255, -1)
    expected = change_across(picture, mask)
    assert len(expected) > 20
    np.testing.assert_allclose(
        np.sort(change_at_outline(picture, mask) @ OFFSETS), np.sort(expected @ OFFSETS), atol=1e-4
    )
    assert not len(change_at_outline(picture, np.zeros_like(mask)))
    assert not len(change_at_outline(picture, mask[1:]))
