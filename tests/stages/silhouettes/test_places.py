"""A silhouette that contradicts all others at one place loses its say there, and nowhere else."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.silhouettes.agreement import agreement
from posegaussian.stages.silhouettes.hidden import without_hidden
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius
from posegaussian.stages.silhouettes.places import (
    AROUND,
    agreed,
    contradicting,
    few_carvers,
    foreground_rays,
    lacking,
    missed,
    reconciled,
)
from posegaussian.stages.silhouettes.tangents import outline, touching
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person

VIEWS = list(range(8))


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=128, frames=1)


def prepared(person: PersonCapture, masks: dict[int, np.ndarray]) -> Silhouettes:
    centre = look_at_point(person.rig.subset(VIEWS))
    return Silhouettes.of(person.rig, masks, centre, searched_radius(person.rig, VIEWS, centre))


def given(person: PersonCapture) -> dict[int, np.ndarray]:
    return {v: person.mask[0, v].copy() for v in VIEWS}


def test_exact_silhouettes_stay_as_they_are(person: PersonCapture) -> None:
    masks = given(person)
    before = prepared(person, masks)
    assert (
        reconciled(person.rig, masks, before, agreement(person.rig, masks, before).unexplained).distance
        == before.distance
    ).all()


def test_what_one_mask_lacks_is_given_back_there_alone(person: PersonCapture) -> None:
    """Its feet: the mask ends above them. Little more is given back than was taken."""
    masks = given(person)
    rows = np.nonzero(masks[3].any(axis=1))[0]
    cut = int(rows[-1] - 12)
    lacking = masks[3].copy()
    lacking[cut:] = 0
    before = prepared(person, masks | {3: lacking})
    after = reconciled(
        person.rig, masks | {3: lacking}, before, agreement(person.rig, masks | {3: lacking}, before).unexplained
    )
    changed = after.distance < before.distance
    others = changed[[v for v in VIEWS if v != 3]].sum()
    assert 2 * others < changed[3].sum(), "a ray may leave the hull nearer to another outline: a few discs of theirs"
    lost = (masks[3] >= 128) & (lacking < 128)
    assert (after.distance[3][lost] <= 0.5).mean() > 0.9
    far = prepared(person, masks).distance[3] > AROUND + 1
    assert (changed[3] & far).sum() < 0.2 * changed[3].sum(), "a ray's nearest miss may lie before or behind the feet"


def test_what_one_mask_has_too_much_is_carved_by_the_others(person: PersonCapture) -> None:
    masks = given(person)
    masks[3][5:25, 5:25] = 255
    before = prepared(person, masks)
    after = reconciled(person.rig, masks, before, agreement(person.rig, masks, before).unexplained)
    assert (after.distance == before.distance).mean() > 0.999


def test_fewer_than_four_masks_overrule_nobody(person: PersonCapture) -> None:
    masks = {v: m for v, m in given(person).items() if v < 3}
    masks[1][60:] = 0
    before = prepared(person, masks)
    assert reconciled(person.rig, masks, before, agreement(person.rig, masks, before).unexplained) is before


def test_outermost_points_of_outlines_lie_on_each_others_lines(person: PersonCapture) -> None:
    """Within the pixel at which masks end, for whatever shape; of what the picture cuts off nothing is known."""
    outlines = {v: outline(person.mask[0, v]) for v in VIEWS}
    told = 0
    for a in VIEWS:
        for b in VIEWS[a + 1 :]:
            first, second = touching(person.rig, (a, b), outlines[a], outlines[b])
            off = signed_epipolar_distance(fundamental(person.rig, a, b), first, second)
            assert (np.abs(off) <= 1.0).all()
            told += len(off)
    assert told > 20
    cut = outline(person.mask[0, 0][20:-20])
    assert not cut[1].all()
    corners, free = outline(np.zeros((16, 16), np.uint8))
    assert len(corners) == len(free) == 0


def cut(mask: np.ndarray, share: float) -> np.ndarray:
    """The upper share of what is on a mask."""
    rows = np.nonzero(mask.any(axis=1))[0]
    out = mask.copy()
    out[int(rows[0] + share * (rows[-1] - rows[0])) :] = 0
    return out


@pytest.mark.parametrize(("share", "least"), [(0.85, 0.9), (0.5, 1.0)], ids=["the feet", "its lower half"])
def test_what_a_mask_lacks_is_known_in_its_view_alone(person: PersonCapture, share: float, least: float) -> None:
    """Of a mask that fits no other all that is empty is in doubt; of one that lacks a part, that and no more."""
    masks = given(person)
    less = masks | {3: cut(masks[3], share)}
    silhouettes = agreed(person.rig, less)
    found = {v: lacking(silhouettes, v, less[v]) for v in VIEWS}
    lost = (masks[3] >= 128) & (less[3] == 0)
    assert found[3][lost].mean() >= least
    assert not (found[3] & (less[3] > 0)).any()
    assert sum(found[v].sum() for v in VIEWS if v != 3) < 0.2 * lost.sum(), (
        "a ray may leave it nearer to another outline"
    )
    if 3 in silhouettes.views:
        assert (found[3] & ~lost).sum() < lost.sum(), "discs reach over the edge of what it lacks"


@pytest.mark.parametrize("pair", [(1, 5), (2, 3)], ids=["opposite", "neighbours"])
def test_what_two_masks_lack_six_others_know(person: PersonCapture, pair: tuple[int, int]) -> None:
    """Both without the feet: neither carves them any more, for the others or for depth."""
    masks = given(person)
    less = masks | {v: cut(masks[v], 0.85) for v in pair}
    silhouettes = agreed(person.rig, less)
    for v in pair:
        lost = (masks[v] >= 128) & (less[v] == 0)
        assert lacking(silhouettes, v, less[v])[lost].mean() > 0.9
    before = prepared(person, less)
    hull = without_hidden(person.rig, less, before, agreement(person.rig, less, before).unexplained)
    for view in (0, 6):
        origin, directions = foreground_rays(person.rig, view, masks[view], None)
        assert missed(before, view, origin, directions).mean() > 0.05
        assert missed(hull, view, origin, directions).mean() < 0.02, "toes and what a stride of the grid leaves"


@pytest.mark.parametrize(("count", "of"), [(12, (1, 5, 9)), (16, (1, 2, 3, 4))], ids=["3 of 12", "4 neighbours of 16"])
def test_what_a_quarter_of_many_masks_lack_the_others_know(count: int, of: tuple[int, ...]) -> None:
    """The feet: of many cameras more than two may lack them, and three quarters say that they are there."""
    person = capture_person(views=count, size=128, frames=1)
    masks = {v: person.mask[0, v].copy() for v in range(count)}
    less = masks | {v: cut(masks[v], 0.85) for v in of}
    silhouettes = agreed(person.rig, less)
    for v in of:
        lost = (masks[v] >= 128) & (less[v] == 0)
        assert lacking(silhouettes, v, less[v])[lost].mean() > 0.9
    for view in (0, 7):
        origin, directions = foreground_rays(person.rig, view, masks[view], None)
        assert missed(silhouettes, view, origin, directions).mean() < 0.01


def test_of_many_masks_no_more_are_overruled_at_a_place_than_say_so() -> None:
    """Two of 16 have a border too much: three and four that carve it are right."""
    person = capture_person(views=16, size=128, frames=1)
    wide = (2, 3)
    masks = {v: person.mask[0, v].copy() for v in range(16)}
    masks |= {v: cv2.dilate(masks[v], np.ones((7, 7), np.uint8)) for v in wide}
    centre = look_at_point(person.rig)
    silhouettes = Silhouettes.of(person.rig, masks, centre, searched_radius(person.rig, list(range(16)), centre))
    carvers = []
    for v in wide:
        origin, directions = foreground_rays(person.rig, v, masks[v], None)
        lost = directions[missed(silhouettes, v, origin, directions)]
        carvers.append(few_carvers(silhouettes, v, origin, lost))
    assert np.max(carvers) == 4
    found = contradicting(person.rig, masks, silhouettes, agreement(person.rig, masks, silhouettes).unexplained)
    two_at_most = [(c > 0) & (c <= 2) for c in carvers]
    assert (found == 2).any()
    assert not (found > 0)[~np.any(two_at_most, axis=0)].any()


def test_masks_lack_nothing_where_outlines_differ_a_little() -> None:
    """Exact, and a pixel too small in one view: at 128 px that is a hand."""
    person = capture_person(views=8, size=256, frames=1)
    masks = given(person)
    for own in (masks, masks | {3: cv2.erode(masks[3], np.ones((3, 3)))}):
        silhouettes = agreed(person.rig, own)
        assert not any(lacking(silhouettes, v, own[v]).any() for v in VIEWS)
