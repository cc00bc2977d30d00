"""Laws of the weighted suppression."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.estimators.suppression import overlap, weighted_suppression


def made(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    low = rng.uniform(0, 0.8, (n, 2))
    return (
        np.concatenate([low, low + rng.uniform(0.05, 0.3, (n, 2))], axis=1),
        rng.uniform(0, 1, (n, 4, 2)),
        rng.uniform(0.5, 1, n),
    )


def test_overlap_of_known_boxes() -> None:
    boxes = np.array([[0, 0, 2, 2], [1, 0, 3, 2], [2, 0, 4, 2], [0, 0, 1, 1], [0, 0, 0, 0]], dtype=float)
    assert np.allclose(overlap(boxes[0], boxes), [1, 1 / 3, 0, 1 / 4, 0])
    assert overlap(boxes[4], boxes)[4] == 0


def test_one_answer_passes_unchanged() -> None:
    boxes, points, scores = made(1, 0)
    b, p, s = weighted_suppression(boxes, points, scores, 0.3)
    assert np.allclose(b, boxes)
    assert np.allclose(p, points)
    assert np.array_equal(s, scores)


def test_copies_become_their_weighted_mean_with_the_best_score() -> None:
    boxes = np.array([[0, 0, 1, 1], [0.1, 0, 1.1, 1]])
    points = np.array([[[0.0, 0.0]], [[1.0, 2.0]]])
    b, p, s = weighted_suppression(boxes, points, np.array([0.9, 0.6]), 0.3)
    assert np.allclose(b, [[0.04, 0, 1.04, 1]])
    assert np.allclose(p, [[[0.4, 0.8]]])
    assert s == [0.9]


@pytest.mark.parametrize("seed", range(4))
def test_what_is_left_is_sorted_and_independent_of_the_order_given(seed: int) -> None:
    boxes, points, scores = made(40, seed)
    b, p, s = weighted_suppression(boxes, points, scores, 0.3)
    assert (np.diff(s) <= 0).all()
    assert 0 < len(s) < 40
    order = np.random.default_rng(seed).permutation(40)
    again = weighted_suppression(boxes[order], points[order], scores[order], 0.3)
    for x, y in zip((b, p, s), again, strict=True):
        assert np.allclose(x, y)


def test_nothing_stays_nothing() -> None:
    b, p, s = weighted_suppression(np.zeros((0, 4)), np.zeros((0, 4, 2)), np.zeros(0), 0.3)
    assert (b.shape, p.shape, s.shape) == ((0, 4), (0, 4, 2), (0,))


def test_boxes_apart_are_all_kept() -> None:
    boxes = np.array([[0, 0, 1, 1], [2, 0, 3, 1], [0, 2, 1, 3]], dtype=float)
    b, _, s = weighted_suppression(boxes, np.zeros((3, 4, 2)), np.array([0.6, 0.9, 0.7]), 0.3)
    assert np.array_equal(b, boxes[[1, 2, 0]])
    assert np.array_equal(s, [0.9, 0.7, 0.6])
