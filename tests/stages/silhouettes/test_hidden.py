"""Where the subject stands behind something: found by the other views, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.silhouettes.hidden import Witnesses
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person

SIZE = 192
VIEWS = range(8)


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=len(VIEWS), size=SIZE, frames=1)


def witnesses(person: PersonCapture, *views: int) -> Witnesses:
    return Witnesses(person.rig, {v: person.mask[0, v] for v in views})


def behind_a_bar(mask: np.ndarray, width: int, across: bool) -> np.ndarray:
    """The mask with a bar before the subject's middle, upright or across."""
    out, (rows, columns) = mask.copy(), np.nonzero(mask)
    if across:
        at = int(np.median(rows))
        out[at : at + width] = 0
    else:
        at = int(np.median(columns)) - width // 2
        out[:, at : at + width] = 0
    return out


def test_of_exact_masks_nothing_is_hidden(person: PersonCapture) -> None:
    for view in VIEWS:
        others = witnesses(person, *(v for v in VIEWS if v != view))
        assert not others.hidden(view, person.mask[0, view]).any()


@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("view", [0, 3])
def test_what_a_bar_hides_is_found_and_little_else(person: PersonCapture, view: int, across: bool) -> None:
    """Most of what is lost: not where limbs are hardly wider than outlines are believed."""
    mask = behind_a_bar(person.mask[0, view], 12, across)
    found = witnesses(person, *(v for v in VIEWS if v != view)).hidden(view, mask)
    lost = (person.mask[0, view] > 127) & (mask <= 127)
    assert found[lost].mean() > 0.75
    assert not found[mask > 127].any(), "the subject is not hidden where it is seen"
    assert (found & ~lost).sum() < lost.sum()


def test_an_outline_that_is_off_hides_nothing(person: PersonCapture) -> None:
    """By 2 px on all sides: a thin line is contradicted."""
    import cv2

    mask = cv2.erode(person.mask[0, 2], np.ones((5, 5), np.uint8))
    assert not witnesses(person, 0, 1, 3, 4, 5, 6, 7).hidden(2, mask).any()


def test_two_others_overrule_nobody(person: PersonCapture) -> None:
    mask = behind_a_bar(person.mask[0, 1], 8, False)
    assert not witnesses(person, 0, 2).hidden(1, mask).any()
    assert not witnesses(person).hidden(1, mask).any()


def test_a_view_that_hides_something_itself_still_bears_witness(person: PersonCapture) -> None:
    """The same bar before two views: each one's loss is found though the other lacks something, too."""
    masks = {v: person.mask[0, v] for v in VIEWS}
    masks |= {v: behind_a_bar(person.mask[0, v], 9, False) for v in (1, 4)}
    found = Witnesses(person.rig, {v: m for v, m in masks.items() if v != 1}).hidden(1, masks[1])
    lost = (person.mask[0, 1] > 127) & (masks[1] <= 127)
    assert found[lost].mean() > 0.6
