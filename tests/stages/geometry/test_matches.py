"""Matches tell a calibration that holds from one that does not, and say nothing where they are chance."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.geometry.features import features, matched
from posegaussian.stages.geometry.matches import epipolar_fit
from posegaussian.stages.geometry.projection import project
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of

SIZE = 1000


def two(turn: float = 0.0) -> Rig:
    """Two cameras 30 degrees apart; `turn`:
    degrees by which the second one's written pose is wrong about its axis and upwards."""
    rig = rig_of([camera(on_ring(a, 10.0, 3.0), np.zeros(3)) for a in (0.0, 30.0)], (SIZE, SIZE), 1000.0)
    if turn:
        axis = np.radians(turn) * np.array([1.0, 0.2, 0.5])
        rig.world_to_camera[1, :3] = cv2.Rodrigues(axis)[0] @ rig.world_to_camera[1, :3]
    return rig


def points(count: int, noise: float, wrong: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of points in space in both cameras, some of them matched with anything."""
    random = np.random.default_rng(seed)
    space = random.uniform(-1, 1, (count, 3))
    x, y = (
        project(space, k, p)[0] + noise * random.normal(size=(count, 2))
        for k, p in zip(two().intrinsics, two().world_to_camera, strict=True)
    )
    wild = random.random(count) < wrong
    y[wild] = random.uniform(0, SIZE, (int(wild.sum()), 2))
    return x, y


def test_points_lie_on_their_epipolar_lines_and_the_distance_is_in_pixels() -> None:
    x, y = points(50, 0.0, 0.0)
    matrix = fundamental(two(), 0, 1)
    np.testing.assert_allclose(signed_epipolar_distance(matrix, x, y), 0.0, atol=1e-9)
    # Moved across its line by a small step, a point lies so far beside it, shared among both pictures: at most the
    # step, at least its half.
    lines = np.concatenate([x, np.ones((50, 1))], axis=1) @ matrix.T
    normal = lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    off = np.abs(signed_epipolar_distance(matrix, x, y + 0.1 * normal))
    assert (off < 0.1).all()
    assert (off > 0.05).all()
    assert np.isfinite(signed_epipolar_distance(np.zeros((3, 3)), x, y)).all()


def test_a_good_calibration_is_confirmed_among_wrong_matches() -> None:
    x, y = points(150, 0.5, 0.5)
    fit = epipolar_fit(fundamental(two(), 0, 1), x, y, SIZE)
    assert fit.error is not None
    assert 0.1 < fit.error < 0.6
    assert 0.4 < fit.share < 0.6


def test_a_bad_calibration_is_accused_by_matches_that_fit_each_other() -> None:
    x, y = points(150, 0.5, 0.3)
    fit = epipolar_fit(fundamental(two(1.0), 0, 1), x, y, SIZE)
    assert fit.error is not None
    assert fit.error > 5.0
    assert fit.free_error is not None
    assert fit.free_error < 0.6
    assert fit.free.sum() > 90


def test_few_right_matches_among_many_are_found_by_the_calibration_alone() -> None:
    """A tenth of 200: no free fundamental matrix is to be believed,
    but chance would put two beside their lines, not twenty."""
    x, y = points(200, 0.5, 0.9)
    fit = epipolar_fit(fundamental(two(), 0, 1), x, y, SIZE)
    assert not fit.free.any()
    assert fit.error is not None
    assert fit.error < 1.5


def test_wrong_matches_tell_nothing() -> None:
    for seed in range(6):
        x, y = points(60, 0.0, 1.0, seed)
        fit = epipolar_fit(fundamental(two(), 0, 1), x, y, SIZE)
        assert fit.error is None, seed
        assert not fit.agree.any()
    nothing = epipolar_fit(fundamental(two(), 0, 1), np.zeros((0, 2)), np.zeros((0, 2)), SIZE)
    assert nothing.error is None
    assert nothing.share == 0.0


def test_features_find_a_picture_again_that_was_moved() -> None:
    """Blobs of all sizes, moved by a whole number of pixels:
    matches lie so far apart, and none where the picture is not covered."""
    random = np.random.default_rng(3)
    whole = np.clip(
        128
        + 60
        * sum(cv2.GaussianBlur(random.normal(size=(220, 260, 3)).astype(np.float32), (0, 0), s) * s for s in (2, 4)),
        0,
        255,
    ).astype(np.uint8)
    first, second = whole[10:190, 5:225], whole[16:196, 17:237]
    coverage = np.full(first.shape[:2], 255, np.uint8)
    coverage[:, :60] = 0
    a, b = (
        features(np.ascontiguousarray(first), coverage),
        features(np.ascontiguousarray(second), np.full_like(coverage, 255)),
    )
    pairs = matched(a, b)
    assert len(pairs) > 30
    assert (a.points[:, 0] > 60).all()
    moved = a.points[pairs[:, 0]] - b.points[pairs[:, 1]]
    np.testing.assert_allclose(np.median(moved, axis=0), [12.0, 6.0], atol=0.05)
    flat = np.full((64, 64, 3), 90, np.uint8)
    assert len(matched(features(flat, np.full((64, 64), 255, np.uint8)), a)) == 0
