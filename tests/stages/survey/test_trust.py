"""The vote of pairs: who is wrong, when nobody can tell, and who cannot be accused."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.trust import asks, judged_cameras
from posegaussian.stages.survey.measures.agreement import NAME
from posegaussian.stages.survey.trust import TRUST

FEATURES, OUTLINES, JOINTS, CARVING = range(4)
OFF = {FEATURES: 0.02, OUTLINES: 0.02, JOINTS: 0.03}


def notes(count: int) -> np.ndarray:
    """[S, S, 4, 2] of cameras that share nothing."""
    return np.zeros((count, count, 4, 2))


def told(pairs: np.ndarray, kind: int, a: int, b: int, off: float) -> None:
    pairs[min(a, b), max(a, b), kind] = off, 20


def parties(count: int, wrong: set[int], kind: int = OUTLINES) -> np.ndarray:
    """Two parties, each of which agrees within itself."""
    pairs = notes(count)
    for a in range(count):
        for b in range(a + 1, count):
            told(pairs, kind, a, b, OFF[kind] if (a in wrong) != (b in wrong) else 0.0)
    return pairs


def left_out(pairs: np.ndarray, setting: object = "auto") -> set[int]:
    names = tuple(f"c{i}" for i in range(len(pairs)))
    found = judged_cameras(TRUST, names, setting, {NAME: pairs})  # type: ignore[arg-type]
    return {i for i, n in enumerate(names) if found[n].state == "left out"}


def test_the_larger_party_is_believed_whoever_comes_first() -> None:
    for kind in OFF:
        for count, wrong in ((3, {0}), (8, {2}), (10, {7, 8, 9}), (9, {0, 1, 2, 3})):
            assert left_out(parties(count, wrong, kind)) == wrong


def test_equal_parties_are_both_believed() -> None:
    assert left_out(parties(4, {0, 1})) == set()
    assert left_out(parties(6, {1, 3, 5})) == set()
    assert left_out(parties(2, {0})) == set()


def test_who_shares_nothing_with_anybody_is_not_accused() -> None:
    assert left_out(notes(6)) == set()
    pairs = parties(6, {2})
    pairs[5], pairs[:, 5] = 0, 0
    assert left_out(pairs) == {2}


def test_a_single_accuser_is_no_majority() -> None:
    pairs = parties(6, set())
    told(pairs, OUTLINES, 1, 4, OFF[OUTLINES])
    assert left_out(pairs) == set()
    alone = notes(5)
    told(alone, OUTLINES, 0, 1, OFF[OUTLINES])
    assert left_out(alone) == set()


def test_masks_or_joints_alone_do_not_outvote_features_and_both_together_do() -> None:
    """A mask that is wrong, or a detector; a camera that is out of step before a background that stands still."""
    right = parties(6, set(), FEATURES)
    for kinds, expected in (((OUTLINES,), set()), ((JOINTS,), set()), ((OUTLINES, JOINTS), {3})):
        pairs = right.copy()
        for kind in kinds:
            pairs[:, :, kind] = parties(6, {3}, kind)[:, :, kind]
        assert left_out(pairs) == expected


def test_a_camera_turned_along_all_lines_is_told_by_its_silhouette() -> None:
    """A mask that lacks something carves others and is not carved; one that has too much is carved alone."""
    for own, of_others, expected in ((0.3, 0.2, {2}), (0.0, 0.2, set()), (0.3, 0.0, set())):
        pairs = parties(6, set())
        for a in range(6):
            pairs[a, a, CARVING, 0] = own if a == 2 else of_others
            if a != 2:
                pairs[a, 2, CARVING, 0] = of_others
        assert left_out(pairs) == expected


def test_the_survey_is_asked_only_where_it_has_a_say() -> None:
    assert asks(TRUST, ("a", "b", "c"), "auto")
    assert asks(TRUST, ("a", "b", "c"), ["a"])
    assert not asks(TRUST, ("a", "b"), "auto")
    assert not asks(TRUST, ("a", "b", "c"), "all")
    assert not asks(TRUST, ("a", "b", "c"), ["c", "b", "a"])
    assert left_out(parties(8, {2}), "all") == set()
    assert left_out(parties(8, {2}), ["c2"]) == set()
    assert left_out(parties(8, {2}), ["c1"]) == {2}
