"""The judge's frames are evenly spread over those that show somebody, and over all where nobody comes or goes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, MASKS, Facts
from posegaussian.stages.contract.io import Views
from posegaussian.stages.contract.judged import GIVEN_MATTE, PERSON_MATTE, PLATE_MATTE
from posegaussian.stages.judge.footage import ASKED, frames_with_somebody, spread
from tests.support.acting_estimator import Actor, Numbered
from tests.support.frame_readers import Pictures
from tests.support.walking_skeleton import Joints2D, pixels, ring, walk

VIEWS, FRAMES, SIZE, FIRST = 4, 24, 64, 1000
BY = {
    "masks": frozenset({MASKS, GIVEN_MATTE}),
    "joints": frozenset({JOINTS2D, PERSON_MATTE}),
    "estimator": frozenset({JOINTS2D, PERSON_MATTE, ESTIMATED}),
    "plate": frozenset({PLATE_MATTE}),
}
TELL = ["masks", "joints", "estimator"]


def chosen(by: str, there: np.ndarray, most: int = 2, valid: np.ndarray | None = None) -> tuple[list[int], Actor]:
    """Of a capture in which somebody is where `there` [F, V] says, frames worked from the first of it on."""
    rig = ring(VIEWS, SIZE)
    seen = pixels(rig, walk(FRAMES))
    people = [[[seen[f, v]] * int(there[f, v]) for v in range(VIEWS)] for f in range(FRAMES)]
    valid = np.ones((FRAMES, VIEWS), bool) if valid is None else valid
    masks = [
        [np.full((8, 8), 255 * there[f, v], np.uint8) if valid[f, v] else None for f in range(FRAMES)]
        for v in range(VIEWS)
    ]
    actor = Actor(people, people)
    readers = {
        "pictures": Numbered(FRAMES, (SIZE, SIZE)),
        "masks": Pictures(masks),
        "joints": Joints2D(people),
        "estimator": actor,
    }
    inputs: Any = SimpleNamespace(
        facts=Facts(BY[by]),
        views=Views(rig.names, tuple(range(VIEWS)), ()),
        rig=rig,
        footage=lambda array: (np.arange(FRAMES), valid),
        source=readers.__getitem__,
    )
    return frames_with_somebody(inputs, most).tolist(), actor


@pytest.mark.parametrize("by", BY)
@pytest.mark.parametrize("most", [1, 2, 5])
def test_of_somebody_who_stays_the_frames_are_spread_over_all(by: str, most: int) -> None:
    always = np.ones((FRAMES, VIEWS), int)
    usual = spread(FRAMES, most).tolist()
    assert chosen(by, always, most)[0] == usual
    always[usual, : VIEWS // 2] = 0
    assert chosen(by, always, most)[0] == usual, "half of the views see somebody"
    assert chosen(by, 0 * always, most)[0] == usual, "nobody is found in any"


@pytest.mark.parametrize("by", TELL)
def test_frames_in_which_nobody_is_judge_nothing(by: str) -> None:
    late, early = np.zeros((2, FRAMES, VIEWS), int)
    late[15:] = 1
    early[:9] = 1
    for there in (late, early):
        found, actor = chosen(by, there)
        assert len(set(found)) == 2
        assert there[found].all()
        if by == "estimator":
            assert len(actor.asked) <= (ASKED + 2) * VIEWS, "it takes seconds a picture"


@pytest.mark.parametrize("by", TELL)
def test_frames_that_few_views_see_somebody_in_judge_nothing(by: str) -> None:
    there = np.zeros((FRAMES, VIEWS), int)
    there[:, 0] = 1
    there[11:14] = 1
    found, _ = chosen(by, there)
    assert set(found) <= {11, 12, 13}
    assert found


def test_without_anything_that_tells_where_somebody_is_the_frames_are_spread_over_all() -> None:
    assert chosen("plate", np.zeros((FRAMES, VIEWS), int))[0] == spread(FRAMES, 2).tolist()


def test_frames_that_a_view_lacks_are_not_asked_for() -> None:
    there, valid = np.zeros((FRAMES, VIEWS), int), np.ones((FRAMES, VIEWS), bool)
    there[12:] = 1
    valid[::2, 1] = False
    found, _ = chosen("masks", there, 2, valid)
    assert valid[found].all()
    assert there[found].all()
