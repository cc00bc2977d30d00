"""Somebody else's arm in the masks of a few views: found, and nothing of the subject with it."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.silhouettes.agreement import settled
from posegaussian.stages.silhouettes.hull import searched_radius
from posegaussian.stages.silhouettes.places import agreed, beyond
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person

SIZE = 192
VIEWS = range(6)


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=len(VIEWS), size=SIZE, frames=1)


def masks(person: PersonCapture) -> dict[int, np.ndarray]:
    return {v: person.mask[0, v] for v in VIEWS}


def with_arm(mask: np.ndarray) -> np.ndarray:
    """The mask with an arm that reaches in from the picture's right edge to the hip."""
    out, (rows, columns) = mask.copy(), np.nonzero(mask)
    at = int(np.median(rows))
    out[at - 5 : at + 6, columns[rows == at].max() :] = 255
    return out


def without_foot(mask: np.ndarray) -> np.ndarray:
    out, rows = mask.copy(), np.nonzero(mask)[0]
    out[rows.max() - np.ptp(rows) // 8 :] = 0
    return out


def kept(person: PersonCapture, given: Mapping[int, np.ndarray]) -> Mapping[int, np.ndarray]:
    """What is left of masks."""
    centre = look_at_point(person.rig.subset(list(given)))
    return settled(person.rig, given, centre, searched_radius(person.rig, list(given), centre))[0]


@pytest.mark.parametrize("views", [(1,), (1, 2), (2, 5)])
def test_an_arm_in_the_masks_of_few_views_is_taken_out_and_nothing_of_the_subject(
    person: PersonCapture, views: tuple[int, ...]
) -> None:
    given = masks(person)
    given |= {v: with_arm(given[v]) for v in views}
    left = kept(person, given)
    silhouettes = agreed(person.rig, given)
    for v in VIEWS:
        true, arm = person.mask[0, v], (given[v] > 0) & (person.mask[0, v] == 0)
        assert (left[v][true > 127] > 127).all()
        if v in views:
            assert (left[v][arm] > 0).mean() < 0.15
            assert (beyond(silhouettes, v, given[v]) & arm).sum() > 0.7 * arm.sum()
        else:
            assert left[v] is given[v]
            assert not beyond(silhouettes, v, given[v]).any()


@pytest.mark.parametrize("lacking", [(), (0,), (0, 3)], ids=["exact", "a foot in one", "a foot in two"])
def test_what_few_masks_lack_is_nobody_elses_in_the_others(person: PersonCapture, lacking: tuple[int, ...]) -> None:
    given = masks(person)
    given |= {v: without_foot(given[v]) for v in lacking}
    assert kept(person, given) is given


def test_outlines_that_run_a_little_beside_the_others_stay(person: PersonCapture) -> None:
    given = masks(person)
    given[2] = cv2.dilate(given[2], np.ones((7, 7), np.uint8))
    assert (np.asarray(kept(person, given)[2])[person.mask[0, 2] > 127] > 127).all()


def test_among_four_views_nobody_is_outvoted(person: PersonCapture) -> None:
    given = {v: m for v, m in masks(person).items() if v < 4}
    given[1] = with_arm(given[1])
    assert kept(person, given) is given
