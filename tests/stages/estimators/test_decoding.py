"""BlazePose's outputs, made up and read back."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.estimators.anchors import anchors
from posegaussian.stages.estimators.decoding import centred, detections, landmarks, refined, sigmoid


def test_sigmoid_keeps_its_bounds_and_its_symmetry() -> None:
    x = np.array([-1e30, -100, -1, 0, 1, 100, 1e30], np.float32)
    assert np.allclose(sigmoid(x) + sigmoid(-x), 1)
    assert sigmoid(x)[0] == 0
    assert sigmoid(x)[-1] == 1
    assert np.allclose(sigmoid(np.array([1.0], np.float32)), 1 / (1 + np.exp(-1)))


def answer(at: int, box: tuple[float, float, float, float], points: np.ndarray) -> np.ndarray:
    """The 12 numbers with which anchor `at` says box (centre, size) and points, shares of the input."""
    a = anchors()[at].astype(float)
    return 224 * np.concatenate([np.array(box[:2]) - a, box[2:], (points - a).ravel()])


def test_a_detection_is_read_from_any_anchor() -> None:
    points = np.array([[0.4, 0.5], [0.4, 0.2], [0.45, 0.35], [0.5, 0.3]])
    for at in (0, 1000, 1700, 2253):
        raw, logits = np.zeros((2254, 12), np.float32), np.full(2254, -1e4, np.float32)
        raw[at], logits[at] = answer(at, (0.5, 0.25, 0.1, 0.2), points), 3.0
        found = detections(raw, logits, anchors(), 0.5)
        assert np.allclose(found.boxes, [[0.45, 0.15, 0.55, 0.35]], atol=1e-6)
        assert np.allclose(found.points, points[None], atol=1e-6)
        assert np.allclose(found.scores, 1 / (1 + np.exp(-3)))


def test_two_people_are_two_and_a_weak_one_is_none() -> None:
    raw, logits = np.zeros((2254, 12), np.float32), np.full(2254, -1e4, np.float32)
    points = np.full((4, 2), 0.5)
    for at, x, logit in ((10, 0.2, 2.0), (11, 0.21, 1.0), (900, 0.8, 4.0), (1500, 0.5, -0.1)):
        raw[at], logits[at] = answer(at, (x, 0.5, 0.1, 0.1), points), logit
    found = detections(raw, logits, anchors(), 0.5)
    assert np.allclose(found.boxes[:, [0, 2]].mean(1), [0.8, 0.2], atol=6e-3)
    assert found.scores[0] > found.scores[1]


def made(places: np.ndarray, spread: float = 2.0) -> np.ndarray:
    """Heatmaps [64, 64, J] of Gaussians whose cell (i, j) stands at (j/64, i/64)."""
    i, j = np.mgrid[:64, :64]
    return np.exp(
        -((j[..., None] - 64 * places[:, 0]) ** 2 + (i[..., None] - 64 * places[:, 1]) ** 2) / (2 * spread**2)
    ).astype(np.float32)


def test_landmarks_are_px_of_the_crop_and_scores_two_sigmoids() -> None:
    rng = np.random.default_rng(0)
    raw = rng.normal(0, 2, (39, 5)).astype(np.float32)
    raw[:, :2] = rng.uniform(0, 256, (39, 2))
    places, scores = landmarks(raw.ravel(), np.zeros((64, 64, 39), np.float32))
    assert np.allclose(places, raw[:, :2] / 256)
    assert np.allclose(scores, 1 / (1 + np.exp(-raw[:, 3])) / (1 + np.exp(-raw[:, 4])), atol=1e-6)


def test_refinement_goes_to_the_heatmap_s_peak() -> None:
    truth = np.random.default_rng(1).uniform(0.2, 0.8, (39, 2))
    start = truth + np.random.default_rng(2).uniform(-0.01, 0.01, (39, 2))
    found = refined(start, made(truth, spread=1.0))
    # the mean over 7 x 7 cells is not quite the peak where it lies off the middle cell: a sixth of a cell here
    assert np.abs(found - truth).max() < 0.17 / 64
    assert np.abs(found - truth).mean() < np.abs(start - truth).mean() / 3


def test_refinement_leaves_the_unsure_and_the_far_alone() -> None:
    places = np.array([[0.5, 0.5], [1.2, 0.5], [-0.1, 0.5], [0.5, 1.0]])
    assert np.array_equal(refined(places, 0.49 * made(places)), places)
    assert np.array_equal(refined(places, made(places))[1:], places[1:])


@pytest.mark.parametrize("spread", [1.5, 2.5])
def test_centred_maps_stand_at_the_cells_centres(spread: float) -> None:
    places = np.random.default_rng(3).uniform(0.2, 0.8, (17, 2))
    maps = centred(made(places, spread))
    i, j = np.mgrid[:64, :64] + 0.5
    total = maps.sum((0, 1))
    found = np.stack([(maps * j[..., None]).sum((0, 1)), (maps * i[..., None]).sum((0, 1))], 1) / total[:, None] / 64
    assert np.abs(found - places).max() < 0.01 / 64
    truth = np.exp(
        -((j[..., None] - 64 * places[:, 0]) ** 2 + (i[..., None] - 64 * places[:, 1]) ** 2) / (2 * spread**2)
    )
    assert np.abs(maps - truth).max() < 0.04
    assert maps.min() >= 0
    assert maps.max() <= 1
