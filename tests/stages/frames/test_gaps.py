"""Gaps that masks fill are found by the backdrop in them, whatever its colours, and nothing of a person is."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from posegaussian.stages.frames.effects import GAP_OPENING, proven_gaps
from posegaussian.stages.frames.gaps import Gaps, gaps_in, opened
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.joint_sets import COCO17
from posegaussian.storage.model.masks import foreground
from tests.support.frame_readers import before, wall

SIZE = 256
PLAIN = {"black": (0, 0, 0), "green": (40, 190, 70), "white": (250, 250, 250)}


@pytest.fixture(scope="module")
def kicking() -> PersonCapture:
    """Arms and legs apart, from four sides."""
    return capture_person(4, SIZE, 1, 0, motion="kick")


def backdrops(view: int) -> dict[str, np.ndarray]:
    flat = {name: np.broadcast_to(np.array(color, float), (SIZE, SIZE, 3)) for name, color in PLAIN.items()}
    return {**flat, "a mottled wall": wall(SIZE, view)}


def filled(mask: np.ndarray) -> np.ndarray:
    """The mask with what lies between limbs closed."""
    return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (25, 25)))


def found_in(person: PersonCapture, view: int, picture: np.ndarray, mask: np.ndarray) -> Gaps:
    found = gaps_in(picture, mask, person.joints2d[0, view].reshape(-1, 17, 3), COCO17.id)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("name", "left", "taken"), [*((name, 0.4, 0.0) for name in PLAIN), ("a mottled wall", 0.5, 0.01)]
)
def test_gaps_are_opened_before_any_backdrop_and_the_person_stays(
    kicking: PersonCapture, name: str, left: float, taken: float
) -> None:
    """From the front and from behind, where limbs lie apart. Of what a mask has too much there stays what is narrower
    than three pixels, the pixels along the person that are mixed, of a person 150 px tall, and more of it before a wall
    that has the colours of cloth here and there."""
    for view in (0, 2):
        truth, picture = kicking.mask[0, view], before(kicking, view, backdrops(view)[name])
        mask, person = filled(truth), foreground(truth)
        too_much = int((foreground(mask) & ~person).sum())
        found = found_in(kicking, view, picture, mask)
        assert (found.where & person).sum() <= taken * person.sum()
        kept = foreground(opened(mask, found.where))
        assert (kept & ~person).sum() <= left * too_much
        assert (person & ~kept).sum() <= (0.01 + 3 * taken) * person.sum(), "a gap reaches half a pixel farther"
        assert found.share == pytest.approx(found.where.sum() / foreground(mask).sum())
        assert found.share > GAP_OPENING.threshold
        if name in PLAIN:
            assert proven_gaps(np.array([[found.share, found.doubt]]))[0] == found.share


@pytest.mark.parametrize("name", [*PLAIN, "a mottled wall"])
def test_exact_masks_have_none(kicking: PersonCapture, name: str) -> None:
    """Or a quarter of what calls for the effect, before a wall that has the colours of cloth here and there."""
    most = 0.0 if name in PLAIN else GAP_OPENING.threshold / 4
    for view in range(4):
        found = found_in(kicking, view, before(kicking, view, backdrops(view)[name]), kicking.mask[0, view])
        assert found.share <= most


def test_clothes_of_the_backdrops_colour_are_not_taken_for_it(kicking: PersonCapture) -> None:
    """Whatever part of the body the backdrop has the colour of."""
    for view in range(4):
        truth = kicking.mask[0, view]
        rows = np.flatnonzero(foreground(truth).any(axis=1))
        for share in (0.1, 0.35, 0.5, 0.75):
            row = int(rows[int(share * len(rows))])
            color = np.median(kicking.color[0, view, row][truth[row] > 250], axis=0)
            picture = before(kicking, view, np.broadcast_to(color, (SIZE, SIZE, 3)))
            found = found_in(kicking, view, picture, truth)
            assert found.share <= GAP_OPENING.threshold, (view, share)


def test_whose_joints_lie_elsewhere_tell_nothing(kicking: PersonCapture) -> None:
    picture, mask = before(kicking, 0, backdrops(0)["green"]), filled(kicking.mask[0, 0])
    joints = kicking.joints2d[0, 0].reshape(-1, 17, 3)
    aside, unknown = joints.copy(), joints.copy()
    aside[..., 0] += SIZE
    unknown[..., 2] = 0
    assert gaps_in(picture, mask, aside, COCO17.id) is None
    assert gaps_in(picture, mask, unknown, COCO17.id) is None
    assert gaps_in(picture, mask, joints[:0], COCO17.id) is None
    assert gaps_in(picture, np.zeros_like(mask), joints, COCO17.id) is None
    alone, beside = (gaps_in(picture, mask, people, COCO17.id) for people in (joints, np.concatenate([joints, aside])))
    assert alone is not None
    assert beside is not None
    np.testing.assert_array_equal(alone.where, beside.where)


def test_where_in_the_picture_somebody_stands_changes_nothing(kicking: PersonCapture) -> None:
    picture, mask = before(kicking, 0, backdrops(0)["green"]), filled(kicking.mask[0, 0])
    whole = found_in(kicking, 0, picture, mask)
    rows, columns = 40, 64
    moved = replace(kicking, joints2d=kicking.joints2d + np.array([columns, rows, 0.0]))
    around = (rows, 0), (columns, 0)
    wider = found_in(moved, 0, np.pad(picture, (*around, (0, 0)), "edge"), np.pad(mask, around))
    np.testing.assert_array_equal(wider.where[rows:, columns:], whole.where)


def test_a_mask_never_grows_and_loses_nothing_away_from_gaps(kicking: PersonCapture) -> None:
    mask = filled(kicking.mask[0, 0])
    where = found_in(kicking, 0, before(kicking, 0, backdrops(0)["green"]), mask).where
    left = opened(mask, where)
    assert (left <= mask).all()
    assert not left[cv2.erode(where.astype(np.uint8), np.ones((5, 5))) > 0].any()
    far = cv2.dilate(where.astype(np.uint8), np.ones((11, 11))) == 0
    np.testing.assert_array_equal(left[far], mask[far])
    np.testing.assert_array_equal(opened(mask, np.zeros_like(where)), mask)


def test_what_might_be_the_body_proves_nothing() -> None:
    assert proven_gaps(np.array([[0.2, 0.0], [0.2, 0.1], [0.2, 0.11], [0.0, 0.0]])).tolist() == [0.2, 0.2, 0, 0]
