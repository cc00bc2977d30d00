"""No point leaves the silhouettes: it goes on to the surface that it nearly reached, or back;
what stays inside is not touched."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.network.inference import Learned, refined
from posegaussian.stages.network.silhouettes import TOLERANCE, held, silhouettes_of
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.storage.model.cameras import Rig, points_to_integer_centres
from tests.support.known_geometry import camera, on_ring, rig_of, sphere_depth, sphere_mask

SIZE = (160, 160)
AWAY = 6.0
"""Metres of the cameras, and 120 px a metre:
balls stand in front of each other within the share by which a depth may change."""
RADIUS = 0.15
NEAR, FAR = np.array([0.35, 0.0, 0.0]), np.array([-0.35, 0.0, 0.0])
"""Two balls behind each other for the first camera, beside each other for the second: 0.4 m of gap."""


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_of(
        [camera(on_ring(a, elevation=0.0, radius=AWAY), np.zeros(3)) for a in (0.0, 90.0, 180.0)],
        SIZE,
        focal=120.0 * AWAY,
    )


@pytest.fixture(scope="module")
def masks(rig: Rig) -> dict[int, np.ndarray]:
    return {v: np.maximum(*(sphere_mask(rig, v, c, RADIUS) for c in (NEAR, FAR))) for v in range(3)}


@pytest.fixture(scope="module")
def depth(rig: Rig) -> np.ndarray:
    """Of the near ball, from the first camera."""
    return sphere_depth(rig, 0, NEAR, RADIUS).astype(np.float32)


def said(depth: np.ndarray, x: float | np.ndarray) -> Learned:
    """A change after which the points lie at `x` along the first camera's axis, `AWAY` before it."""
    change = np.where(depth > 0, 1 / (AWAY - x) - 1 / np.where(depth > 0, depth, 1), 0).astype(np.float32)
    everywhere = (depth > 0).astype(np.float32)
    return Learned(change, everywhere, everywhere / 2, np.zeros((8, *depth.shape), np.float32))


def outside(rig: Rig, depth: np.ndarray, silhouettes: Silhouettes, view: int = 1) -> np.ndarray:
    """Px by which the points of the first view lie outside a silhouette, [h, w]."""
    pixels, _ = project(
        unproject(depth, rig.intrinsics[0], rig.world_to_camera[0]), rig.intrinsics[view], rig.world_to_camera[view]
    )
    x, y = np.moveaxis(points_to_integer_centres(pixels).astype(np.float32), -1, 0)
    return np.where(
        depth > 0, cv2.remap(silhouettes.distance[silhouettes.views.index(view)], x, y, cv2.INTER_LINEAR), 0
    )


def middle(depth: np.ndarray) -> float:
    """X of the point in the picture's middle."""
    return AWAY - float(depth[SIZE[1] // 2, SIZE[0] // 2])


def test_a_point_that_nearly_reached_a_surface_goes_on_to_it(
    rig: Rig, masks: dict[int, np.ndarray], depth: np.ndarray
) -> None:
    near_the_far_ball = FAR[0] + RADIUS + 0.08
    learned = held(rig, 0, depth, said(depth, near_the_far_ball), silhouettes_of(rig, masks))
    # The silhouette's edge, the tolerance of 0.0125 m before it and a step of a sixteenth of 0.62 m behind it.
    assert FAR[0] + RADIUS - 0.06 < middle(refined(depth, learned)) < FAR[0] + RADIUS + 0.02
    assert learned.confidence.max() == 1
    assert learned.share.max() == 0.5


def test_a_point_that_has_just_left_its_surface_goes_back_to_it(
    rig: Rig, masks: dict[int, np.ndarray], depth: np.ndarray
) -> None:
    just_behind = NEAR[0] - RADIUS - 0.05
    learned = held(rig, 0, depth, said(depth, just_behind), silhouettes_of(rig, masks))
    assert NEAR[0] - RADIUS - 0.02 < middle(refined(depth, learned)) < NEAR[0] - RADIUS + 0.04
    # 0.30 of 0.35 m.
    assert learned.confidence[SIZE[1] // 2, SIZE[0] // 2] == pytest.approx(0.85, abs=0.07)
    np.testing.assert_array_equal(learned.share, learned.confidence / 2)


def test_what_stays_inside_and_what_is_no_number_keep_every_bit(
    rig: Rig, masks: dict[int, np.ndarray], depth: np.ndarray
) -> None:
    silhouettes = silhouettes_of(rig, masks)
    for learned in (
        said(depth, FAR[0]),
        said(depth, np.nan),
        Learned(
            np.zeros_like(depth), np.zeros_like(depth), np.zeros_like(depth), np.zeros((8, *depth.shape), np.float32)
        ),
    ):
        again = held(rig, 0, depth, learned, silhouettes)
        inner = cv2.erode((depth > 0).astype(np.uint8), np.ones((21, 21), np.uint8)) > 0
        for a, b in ((again.inverse_depth, learned.inverse_depth), (again.confidence, learned.confidence)):
            assert a[inner].tobytes() == b[inner].tobytes()
        assert again.numbers is learned.numbers


def test_no_point_ends_farther_outside_than_the_tolerance_or_its_start(
    rig: Rig, masks: dict[int, np.ndarray], depth: np.ndarray
) -> None:
    wild = said(depth, np.random.default_rng(3).uniform(-0.45, 0.45, depth.shape))
    silhouettes = silhouettes_of(rig, masks)
    allowed = np.maximum(TOLERANCE, outside(rig, depth, silhouettes))
    before, after = (
        outside(rig, refined(depth, s), silhouettes) for s in (wild, held(rig, 0, depth, wild, silhouettes))
    )
    assert (before > allowed + 5).mean() > 0.2 * (depth > 0).mean()
    # `remap` interpolates in steps of 1/32 px.
    assert (after <= allowed + 0.1).all()


def test_a_silhouette_that_is_wrong_as_a_whole_forbids_nothing(
    rig: Rig, masks: dict[int, np.ndarray], depth: np.ndarray
) -> None:
    lifted = {**masks, 1: np.roll(masks[1], -60, axis=0)}
    learned = said(depth, 0.0)
    again = held(rig, 0, depth, learned, silhouettes_of(rig, lifted))
    started = outside(rig, depth, silhouettes_of(rig, lifted))
    assert started[depth > 0].min() > 10
    allowed = outside(rig, refined(depth, learned), silhouettes_of(rig, lifted)) <= started
    assert (again.inverse_depth == learned.inverse_depth)[allowed].all()


def test_a_view_says_nothing_of_its_own_points_or_of_what_it_does_not_see(
    rig: Rig, masks: dict[int, np.ndarray], depth: np.ndarray
) -> None:
    learned = said(depth, 0.0)
    nobody = {0: masks[0], 1: np.zeros_like(masks[1])}
    assert (
        held(rig, 0, depth, learned, silhouettes_of(rig, nobody)).inverse_depth.tobytes()
        == learned.inverse_depth.tobytes()
    )
    beside = Rig(
        rig.names,
        rig.intrinsics + 400.0 * (np.arange(3)[:, None, None] == 1) * np.eye(3)[0][:, None] * np.eye(3)[2],
        rig.distortion,
        rig.world_to_camera,
        rig.size,
    )
    assert (
        held(beside, 0, depth, learned, silhouettes_of(beside, {0: masks[0], 1: masks[1]})).inverse_depth.tobytes()
        == learned.inverse_depth.tobytes()
    )
