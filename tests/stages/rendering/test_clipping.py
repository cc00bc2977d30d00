import numpy as np
import pytest

from posegaussian.stages.rendering.clipping import clipped, cover, filled
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import ring, sphere_mask

CENTRE, RADIUS = np.array([0.1, -0.05, 0.1]), 0.5


def seen_by(rig: Rig, view: int) -> Camera:
    return Camera(rig.intrinsics[view], rig.world_to_camera[view], *(int(n) for n in rig.size[view]))


def test_the_cover_of_a_sphere_is_its_soft_silhouette() -> None:
    rig = ring(24, (96, 96), 90.0)
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(1, 24)}
    found = cover(agreed(rig, masks), seen_by(rig, 0), np.ones((96, 96), bool))
    truth = sphere_mask(rig, 0, CENTRE, RADIUS) / 255
    assert (found[truth == 1] > 0.5).all()
    # The rim of a sphere seen from above and below is bounded by no camera of a ring: a pixel or two remain.
    assert np.abs(found - truth).mean() < 0.02
    assert 0 < ((found > 0.05) & (found < 0.95)).sum() < 0.1 * found.size


def test_without_silhouettes_all_is_covered() -> None:
    rig = ring(4)
    wanted = np.ones((64, 64), bool)
    assert (cover(agreed(rig, {}), seen_by(rig, 0), wanted) == 1).all()
    assert (
        cover(agreed(rig, {v: np.full((64, 64), 255, np.uint8) for v in range(4)}), seen_by(rig, 0), wanted) == 1
    ).all()
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(4)}
    assert (cover(agreed(rig, masks), seen_by(rig, 0), ~wanted) == 1).all()


def test_a_mask_that_contradicts_the_others_clips_nothing() -> None:
    rig = ring(8, (64, 64))
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(8)}
    without = cover(agreed(rig, {v: m for v, m in masks.items() if v != 3}), seen_by(rig, 0), np.ones((64, 64), bool))
    masks[3] = np.roll(masks[3], 25, axis=1)
    found = cover(agreed(rig, masks), seen_by(rig, 0), np.ones((64, 64), bool))
    np.testing.assert_allclose(found, without, atol=0.05)


def test_clipping_takes_color_and_alpha_in_proportion() -> None:
    random = np.random.default_rng(0)
    alpha, covered = random.random((2, 9, 9)).astype(np.float32)
    color = (alpha[..., None] * np.float32([0.2, 0.5, 0.8])).astype(np.float32)
    shown, less = clipped(color, alpha, covered)
    np.testing.assert_array_equal(less, np.minimum(alpha, covered))
    np.testing.assert_allclose(shown, less[..., None] * np.float32([0.2, 0.5, 0.8]), rtol=1e-5)
    same = clipped(color, alpha, np.ones_like(alpha))
    np.testing.assert_allclose(same[0], color, rtol=1e-6)
    np.testing.assert_array_equal(same[1], alpha)


@pytest.mark.parametrize(("hole", "closed"), [((50, 53), True), ((50, 70), False)])
def test_small_holes_take_the_colour_around_and_large_ones_stay(hole: tuple[int, int], closed: bool) -> None:
    alpha = np.zeros((512, 512), np.float32)
    alpha[20:100, 20:100] = 0.98
    alpha[slice(*hole), slice(*hole)] = 0
    # A notch is open to the background.
    alpha[20:26, 40:42] = 0
    color = alpha[..., None] * np.float32([0.9, 0.4, 0.1])
    shown, more = filled(color, alpha, np.ones_like(alpha))
    assert (more >= alpha).all()
    assert (more[slice(*hole), slice(*hole)] > 0.99).all() == closed
    assert not more[20:25, 40:42].any()
    assert not more[alpha == 0][:1000].any()
    np.testing.assert_allclose(shown, more[..., None] * np.float32([0.9, 0.4, 0.1]), atol=1e-3)
    bounded = filled(color, alpha, np.zeros_like(alpha))
    np.testing.assert_array_equal(bounded[1], alpha)


@pytest.mark.parametrize(("width", "closed"), [(3, True), (8, False)])
def test_a_thin_crack_is_closed_however_long_unless_it_opens_to_the_background(width: int, closed: bool) -> None:
    alpha = np.zeros((512, 512), np.float32)
    alpha[50:450, 50:450] = 1
    within, open_to_one_side = (slice(100, 400), slice(200, 200 + width)), (slice(50, 300), slice(300, 300 + width))
    alpha[within] = alpha[open_to_one_side] = 0
    more = filled(alpha[..., None] * np.float32([0.9, 0.4, 0.1]), alpha, np.ones_like(alpha))[1]
    assert (more[within] > 0.99).all() == closed
    assert not more[within].any() or closed
    assert not more[open_to_one_side].any()
