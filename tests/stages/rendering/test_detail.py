"""Detail looked up in source pictures: a textured wall, whose picture is known from everywhere."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres, rays
from posegaussian.stages.rendering.detail import FADE, SHARE, UNLIKE, SourcePicture, detailed
from posegaussian.stages.rendering.lift import GaussianMaps
from posegaussian.stages.splatting.definition.scene import Camera

SIDE, AWAY = 48, 2.0
"""Px of a picture; metres from the wall, which stands across the world's z axis."""
K = np.array([[60.0, 0.0, 24.0], [0.0, 60.0, 24.0], [0.0, 0.0, 1.0]])


def pose(aside: float, turn: float = 0.0) -> np.ndarray:
    """World to camera of one that stands `aside` metres in x, turned about y by `turn` radians."""
    out = np.eye(4)
    out[:3, :3] = [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
    out[:3, 3] = -out[:3, :3] @ [aside, 0, 0]
    return out


def wall(world_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colour [h, w, 3] 0..1 and depth [h, w] m of the wall, whose waves are three px long."""
    origin, directions = rays(pixel_centres((SIDE, SIDE)), K, world_to_camera)
    depth = (AWAY - origin[2]) / directions[..., 2]
    x, y = np.moveaxis(origin[:2] + directions[..., :2] * depth[..., None], -1, 0)
    return np.stack([0.5 + 0.06 * np.sin(f * x + g * y) for f, g in ((60, 0), (0, 60), (45, 45))], -1), depth


def source(world_to_camera: np.ndarray) -> SourcePicture:
    color, depth = wall(world_to_camera)
    return SourcePicture(color.astype(np.float32), depth.astype(np.float32), np.ones_like(depth, np.float32), K,
                         world_to_camera)  # fmt: skip


def blurred(color: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(color.astype(np.float32), (0, 0), 1.0)


def drawn(world_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, Camera]:
    """What Gaussians would draw of the wall: colour, alpha, depth, and the camera."""
    color, depth = wall(world_to_camera)
    return blurred(color), np.ones((SIDE, SIDE), np.float32), depth, Camera(K, world_to_camera, SIDE, SIDE)


def test_where_a_source_camera_stands_its_picture_is_mixed_in_as_it_is() -> None:
    """Sampling at pixels' own centres changes nothing; float32."""
    color, alpha, depth, camera = drawn(pose(0))
    truth = wall(pose(0))[0]
    change = truth - color
    share = SHARE * np.exp(-np.square(change).mean(axis=-1) / (2 * UNLIKE**2))
    found = detailed(color, alpha, depth, camera, [(source(pose(0)), 1.0)])
    np.testing.assert_allclose(found, color + share[..., None] * change, atol=2e-5)


def test_between_sources_a_picture_is_nearer_to_what_the_camera_sees() -> None:
    """By about the share: 1 - SHARE of the blur is left, and bicubic sampling takes some of waves three px long."""
    color, alpha, depth, camera = drawn(pose(0.1, 0.05))
    truth = wall(pose(0.1, 0.05))[0]
    found = detailed(color, alpha, depth, camera, [(source(pose(-0.2)), 0.7), (source(pose(0.4, 0.1)), 1.0)])
    inner = (slice(6, -6), slice(12, -12))  # which both see
    before, after = (float(np.abs(p - truth)[inner].mean()) for p in (color, found))
    assert after < 0.45 * before  # 0.35 is the least; 0.47 where the nearest pixel is taken, 0.49 between four


def test_the_source_whose_ray_is_the_cameras_has_the_say() -> None:
    """Beside one that looks from 11 degrees aside, a chord of 0.2, and has another light: 16 to 1."""
    color, alpha, depth, camera = drawn(pose(0))
    own, aside = source(pose(0)), source(pose(0.4, 0.1))
    brighter = dataclasses.replace(aside, color=aside.color + np.float32(0.05))
    one, other, both = (
        detailed(color, alpha, depth, camera, [(s, 1.0) for s in given])[:, 20:]  # which both see
        for given in ([own], [brighter], [own, brighter])
    )
    assert 0 < np.abs(both - one).mean() < 0.1 * np.abs(both - other).mean()


def test_what_a_source_does_not_see_stays_bit_by_bit() -> None:
    """Behind another surface, beyond its picture, without depth, at its outline, behind the camera."""
    color, alpha, depth, camera = drawn(pose(0))
    own = source(pose(0))
    for blind in (
        dataclasses.replace(own, depth=own.depth * np.float32(0.9)),
        dataclasses.replace(own, depth=own.depth * np.float32(1.1)),
        dataclasses.replace(own, depth=np.zeros_like(own.depth)),
        dataclasses.replace(own, inside=np.zeros_like(own.inside)),
        source(pose(9.0)),
        dataclasses.replace(own, world_to_camera=pose(0, np.pi)),
    ):
        np.testing.assert_array_equal(detailed(color, alpha, depth, camera, [(blind, 1.0)]), color)


def test_another_surface_in_the_same_place_stays_as_it_is_drawn() -> None:
    """A highlight, or a mistaken depth: 150 of 255 beside what is drawn are six times `UNLIKE`, exp(-18)."""
    color, alpha, depth, camera = drawn(pose(0))
    other = dataclasses.replace(source(pose(0)), color=np.clip(wall(pose(0))[0] - 0.59, 0, 1).astype(np.float32))
    found = detailed(color + np.float32(0.3), alpha, depth, camera, [(other, 1.0)])
    np.testing.assert_allclose(found, color + np.float32(0.3), atol=1e-6)


def test_outlines_and_what_is_not_finite_stay() -> None:
    color, alpha, depth, camera = drawn(pose(0))
    alpha[:, :20], depth[:, 30:] = FADE[0], np.inf
    depth[:4] = np.nan
    found = detailed(color, alpha, depth, camera, [(source(pose(0)), 1.0)])
    untouched = np.ones((SIDE, SIDE), bool)
    untouched[4:, 20:30] = False
    np.testing.assert_array_equal(found[untouched], color[untouched])
    assert (found[~untouched] != color[~untouched]).any()
    nothing = np.zeros((SIDE, SIDE), np.float32)
    assert detailed(color, nothing, depth, camera, [(source(pose(0)), 1.0)]) is color


def test_towards_an_outline_the_share_falls_with_alpha() -> None:
    color, alpha, depth, camera = drawn(pose(0))
    thin = np.float32(np.mean(FADE))
    whole, half = (
        detailed(color * a, alpha * a, depth, camera, [(source(pose(0)), 1.0)]) - color * a
        for a in (np.float32(1), thin)
    )
    np.testing.assert_allclose(half, 0.5 * thin * whole, atol=1e-6)


def test_premultiplied_colours_stay_so() -> None:
    """Half as opaque, half as bright: the colour behind alpha changes alike, as far as alpha says surface."""
    color, alpha, depth, camera = drawn(pose(0))
    thin = np.float32(0.95)
    whole, part = (
        detailed(color * a, alpha * a, depth, camera, [(source(pose(0)), 1.0)]) for a in (np.float32(1), thin)
    )
    np.testing.assert_allclose(part / thin, whole, atol=1e-6)


def test_a_coarse_picture_gets_averages_over_its_pixels() -> None:
    """At a quarter of the size waves of 3 px are no detail any more, and would alias: a Gaussian of the variance of
    four px, (16 - 1) / 12, leaves exp(-2 pi^2 1.25 / 9) = 0.06 of them. Finer cameras look up what is there."""
    made, coarse = source(pose(0)), SIDE // 4
    camera = Camera(K * [[0.25], [0.25], [1]], pose(0), coarse, coarse)
    flat = np.full((coarse, coarse, 3), 0.5, np.float32)
    alpha, depth = np.ones((coarse, coarse), np.float32), np.full((coarse, coarse), AWAY)
    inner = (slice(2, -2), slice(2, -2))
    aliased, averaged = (
        float(np.abs(detailed(flat, alpha, depth, camera, [(s, 1.0)]) - flat)[inner].mean())
        for s in (made, made.averaged(4.0))
    )
    assert averaged < 0.1 * aliased
    assert made.averaged(1.0) is made
    assert made.averaged(0.5) is made


def test_what_lies_at_an_outline_is_not_averaged_in() -> None:
    """Colours beside the subject, which are the background's, reach as far as the average does."""
    made = source(pose(0))
    made.inside[:, 24:], made.color[:, 24:] = 0, 1
    color, alpha, depth, camera = drawn(pose(0))
    found = detailed(color, alpha, depth, camera, [(made.averaged(4.0), 1.0)])
    clean = detailed(color, alpha, depth, camera, [(source(pose(0)).averaged(4.0), 1.0)])
    changed = (found != color).any(axis=-1)
    assert changed[:, :18].any()
    np.testing.assert_allclose(found[changed], clean[changed], atol=1e-3)


def test_a_source_that_has_faded_out_has_no_say() -> None:
    color, alpha, depth, camera = drawn(pose(0))
    one, none = (source(pose(0.1)), 1.0), (dataclasses.replace(source(pose(0)), color=source(pose(3)).color), 0.0)
    np.testing.assert_array_equal(
        detailed(color, alpha, depth, camera, [one, none]), detailed(color, alpha, depth, camera, [one])
    )


def test_maps_and_masks_are_taken_as_stages_leave_them() -> None:
    color = np.full((4, 4, 3), 51, np.uint8)
    opacity = np.ones((2, 4, 4), np.float32)
    opacity[:, 3] = 0
    depth = np.ones((4, 4), np.float32)
    depth[2, 2] = np.nan
    maps = GaussianMaps(color, depth, *(np.zeros((3, 4, 4), np.float32) for _ in range(2)), opacity)
    mask = np.full((4, 4), 255, np.uint8)
    mask[0] = 200
    made = SourcePicture.of(maps, K, pose(0), mask)
    assert made.color.max() == np.float32(0.2)
    assert made.inside.tolist() == [[0.0] * 4, *[[1.0] * 4] * 3]
    assert made.depth.tolist() == [[1.0] * 4, [1.0] * 4, [1.0, 1.0, 0.0, 1.0], [0.0] * 4], "where a Gaussian is"


def test_the_outline_of_what_is_nearer_is_not_looked_up_on_what_lies_behind_it() -> None:
    """Its colour reaches a pixel farther than its depth, as matched depth has it; beyond that the wall is looked up."""
    seen, behind = wall(pose(0))
    near, red = np.s_[16:32, 16:32], np.s_[15:33, 15:33]
    seen[red], behind[near] = (0.6, 0.4, 0.4), 0.8 * AWAY
    solid = np.ones((2, SIDE, SIDE), np.float32)
    rest = (np.zeros((3, SIDE, SIDE), np.float32) for _ in range(2))
    maps = GaussianMaps(np.rint(seen * 255).astype(np.uint8), behind.astype(np.float32), *rest, solid)
    made = SourcePicture.of(maps, K, pose(0), np.full((SIDE, SIDE), 255, np.uint8))
    color, alpha, depth, camera = drawn(pose(0))  # of the wall alone
    change = detailed(color, alpha, depth, camera, [(made, 1.0)]) - color
    assert not change[red].any(), "nothing of the square, nor of its rim, lies on the wall"
    truth = wall(pose(0))[0] - color
    farther = np.ones((SIDE, SIDE), bool)
    farther[11:37, 11:37] = False
    assert np.abs(change - SHARE * truth)[farther].mean() < 0.1 * np.abs(truth)[farther].mean()
