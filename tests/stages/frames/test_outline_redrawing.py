"""Outlines that follow the subject by a pixel or two, in waves, are told from exact ones and redrawn where the picture
has its edges."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.stages.frames.effects import OUTLINE_CORRECTION, OUTLINE_REDRAWING, OUTLINES, SLOPES
from posegaussian.stages.frames.outline_redrawing import LEAST_REACH, REACH, redrawn, slopes
from posegaussian.stages.geometry.subject import STATURE
from posegaussian.stages.imaging.outline import moved
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person, ring
from posegaussian.storage.model.masks import foreground
from tests.support.frame_readers import before, wall

SIZE = 256


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    """150 px tall, arms and legs apart, from four sides."""
    return capture_person(4, SIZE, 1, 0, motion="kick")


BACKDROPS = {"green": np.broadcast_to(np.array([40.0, 190, 70]), (SIZE, SIZE, 3)), "a mottled wall": wall(SIZE, 0)}


def in_waves(mask: np.ndarray, view: int, px: float = 1.5) -> np.ndarray:
    """A mask as a network makes it: rounded, its outline off by `px` (root mean square) in waves, soft."""
    rng = np.random.default_rng(10 + view)
    waves = cv2.GaussianBlur(rng.normal(size=mask.shape), (0, 0), 8.0)
    rounded = cv2.GaussianBlur(foreground(mask).astype(np.float32), (0, 0), 2.0)
    away = _away(rounded >= 0.5) - px * waves / waves.std()
    return np.rint(255 / (1 + np.exp(np.clip(away, -50, 50)))).astype(np.uint8)


def _away(inside: np.ndarray) -> np.ndarray:
    """[h, w] px outside of a shape's edge, negative inside."""
    far, deep = (cv2.distanceTransform(a.astype(np.uint8), cv2.DIST_L2, 5) for a in (~inside, inside))
    return np.where(inside, 0.5 - deep, far - 0.5)


def wrong(mask: np.ndarray, truth: np.ndarray) -> int:
    """Pixels that are on the other side of the outline."""
    return int((foreground(mask) ^ foreground(truth)).sum())


def missed(picture: np.ndarray, mask: np.ndarray) -> float:
    """Share of the edges' slope that outlines miss."""
    found = slopes(picture, mask)
    assert found is not None
    return 1 - found.given / found.redrawn


@pytest.mark.parametrize("name", BACKDROPS)
def test_outlines_in_waves_come_back_to_the_subject_s(person: PersonCapture, name: str) -> None:
    """Half of what was wrong is left at most; 0.25 to 0.42 of it here."""
    for view in range(4):
        truth, picture = person.mask[0, view], before(person, view, BACKDROPS[name])
        spoilt = in_waves(truth, view)
        assert wrong(redrawn(picture, spoilt), truth) <= 0.5 * wrong(spoilt, truth), view


@pytest.mark.parametrize("name", BACKDROPS)
def test_outlines_in_waves_miss_edges_and_exact_ones_do_not(person: PersonCapture, name: str) -> None:
    """Nor do outlines that are off by a px all around: those are moved as a whole."""
    for view in range(4):
        truth, picture = person.mask[0, view], before(person, view, BACKDROPS[name])
        assert missed(picture, in_waves(truth, view)) > OUTLINE_REDRAWING.threshold, view
        for exact in (truth, np.where(foreground(truth), np.uint8(255), np.uint8(0)), moved(truth, 1.0)):
            assert missed(picture, exact) < OUTLINE_REDRAWING.threshold / 2, view


def test_where_nothing_tells_the_subject_from_what_is_behind_the_mask_stays(person: PersonCapture) -> None:
    """In a picture of one colour, but for what is rounded: pixels beside the outline, half a px off."""
    picture = np.full((SIZE, SIZE, 3), 120, np.uint8)
    for view in range(4):
        given = person.mask[0, view]
        changed = foreground(redrawn(picture, given)) ^ foreground(given)
        assert not (changed & (np.abs(_away(foreground(given))) > 1.5)).any()
        assert slopes(picture, given) is None


def test_what_lies_farther_from_the_outline_than_it_is_moved_stays(person: PersonCapture) -> None:
    """Even where the picture is the backdrop's there."""
    given = person.mask[0, 0]
    reach = max(LEAST_REACH, REACH * SIZE / STATURE)
    picture = np.full((SIZE, SIZE, 3), 120, np.uint8)
    picture[:, : SIZE // 2] = 200  # an edge through the middle of the subject
    for seen in (picture, before(person, 0, BACKDROPS["green"])):
        changed = foreground(redrawn(seen, given)) ^ foreground(given)
        assert not (changed & (np.abs(_away(foreground(given))) > 3 * reach)).any()


def test_a_part_that_colours_do_not_tell_stays(person: PersonCapture) -> None:
    """A ball in the air, small beside the person, of the backdrop's own colour; corners become round."""
    picture, given = before(person, 0, BACKDROPS["green"]), person.mask[0, 0].copy()
    given[10:20, 10:20] = 255
    assert foreground(redrawn(picture, given))[10:20, 10:20].mean() > 0.7


def test_a_subject_elsewhere_in_the_picture_is_redrawn_alike(person: PersonCapture) -> None:
    picture, given = before(person, 0, BACKDROPS["a mottled wall"]), in_waves(person.mask[0, 0], 0)
    around = [np.pad(a, ((40, 24), (64, 16), (0, 0))[: a.ndim], mode="edge") for a in (picture, given)]
    np.testing.assert_array_equal(redrawn(*around)[40 : 40 + SIZE, 64 : 64 + SIZE], redrawn(picture, given))


def test_an_empty_mask_and_a_full_one_stay() -> None:
    picture = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    for value in (0, 255):
        mask = np.full((48, 64), value, np.uint8)
        np.testing.assert_array_equal(redrawn(picture, mask), mask)
        assert slopes(picture, mask) is None


def ragged(*told: tuple[float, float]) -> Any:
    """Evidence of source views whose slopes are (as given, redrawn)."""
    rig = ring(len(told), 64, 0)
    return SimpleNamespace(
        rig=rig, sources=tuple(range(len(told))), facts=frozenset({"masks"}), noted={SLOPES: np.array(told)}
    )


def test_outlines_that_are_redrawn_are_not_moved_besides() -> None:
    evidence = ragged((7.0, 10.0))
    evidence.facts |= {"outline_redrawing"}
    assert OUTLINE_CORRECTION.decide(evidence, 1.0) is None, "until it is noted how far they are off"
    evidence.noted[OUTLINES] = np.array([[3.0, 0.5, 1000.0]])
    found = OUTLINE_CORRECTION.decide(evidence, 1.0)
    assert found is not None
    assert not found.on


def test_the_middle_view_decides_and_views_without_edges_have_no_say() -> None:
    def decided(*told: tuple[float, float]) -> tuple[bool, float | None]:
        found = OUTLINE_REDRAWING.decide(ragged(*told), OUTLINE_REDRAWING.threshold)
        assert found is not None
        return found.on, found.measured

    assert decided((7.0, 10.0), (6.0, 10.0), (9.9, 10.0)) == (True, pytest.approx(0.3))
    assert decided((9.0, 10.0), (6.0, 10.0), (9.9, 10.0)) == (False, pytest.approx(0.1))
    assert decided((9.0, 10.0), (0.5, 1.9), (0.0, 0.0)) == (False, pytest.approx(0.1))
    assert decided((12.0, 10.0)) == (False, 0.0)
    assert decided((0.5, 1.9), (0.0, 0.0)) == (False, None)
