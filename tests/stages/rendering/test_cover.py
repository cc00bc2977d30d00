"""How much of a picture the hull of the silhouettes covers: soft like the masks, and the same however it is found."""

from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.io import Views
from posegaussian.stages.registry import stage
from posegaussian.stages.rendering import clipping
from posegaussian.stages.rendering.clipping import UNSURE, cover, retouched
from posegaussian.stages.rendering.frame import FrameRenderer, MapReader
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.silhouettes import coverage
from posegaussian.stages.silhouettes.coverage import FINE
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import ring, sphere_mask
from tests.support.memory_inputs import MemoryInputs

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


def of_a_sphere(views: int, size: int, margin: int = 0) -> tuple[Silhouettes, Camera]:
    """What `views` cameras say of a sphere, and a camera between two of them, which sees it from nearer."""
    rig = ring(2 * views, (size, size), 180.0)
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(0, 2 * views, 2)}
    for mask in masks.values():
        mask[:margin] = 0
    return agreed(rig, masks), seen_by(rig, 1)


def walked(
    silhouettes: Silhouettes, camera: Camera, wanted: np.ndarray, patch: pytest.MonkeyPatch, step: float = FINE
) -> np.ndarray:
    """The cover without blocks: ray by ray, in steps of so many px."""

    def nothing(_: object, origin: np.ndarray, directions: np.ndarray, around: float) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(len(directions), bool), np.full(len(directions), -1.0)

    with patch.context() as alone:
        alone.setattr(clipping, "covered_around", nothing)
        alone.setattr(coverage, "FINE", step)
        return cover(silhouettes, camera, wanted)


@pytest.mark.parametrize(("views", "margin"), [(2, 0), (3, 0), (8, 0), (8, 90)])
def test_blocks_that_are_covered_as_a_whole_say_what_their_rays_say(
    views: int, margin: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    silhouettes, camera = of_a_sphere(views, 192, margin)
    everything = np.ones((192, 192), bool)
    found = cover(silhouettes, camera, everything)
    np.testing.assert_array_equal(found, walked(silhouettes, camera, everything, monkeypatch))
    assert ((found > 0) & (found < 1)).any()
    assert (found == 1).sum() > 2000


@pytest.mark.parametrize(("views", "margin"), [(2, 0), (3, 0), (8, 0), (8, 90)])
def test_a_known_surface_says_no_less_than_a_walk_and_no_more_than_a_finer_one(
    views: int, margin: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A walk looks at the share every half px, and so misses the largest by a quarter of a px, or a little more in
    views nearer than the sharpest; at the surface it may be looked at nearer to it. In sixteenths of the step it is
    missed by no more than 0.03."""
    silhouettes, camera = of_a_sphere(views, 192, margin)
    everything = np.ones((192, 192), bool)
    depth = np.full((192, 192), np.linalg.norm(camera.centre - CENTRE), np.float32)
    found = cover(silhouettes, camera, everything, depth=depth)
    at_least = walked(silhouettes, camera, everything, monkeypatch)
    finer = walked(silhouettes, camera, everything, monkeypatch, FINE / 16)
    assert (found >= at_least).all()
    # A single point, at the edge of a picture, may be found by either walk alone.
    assert (found <= np.maximum(at_least, finer) + 0.03).all()


def test_a_part_of_a_picture_is_covered_as_in_the_whole() -> None:
    silhouettes, camera = of_a_sphere(6, 128)
    whole = cover(silhouettes, camera, np.ones((128, 128), bool))
    part = cover(silhouettes, camera, np.ones((61, 43), bool), corner=(21, 34))
    np.testing.assert_array_equal(part, whole[21:82, 34:77])


def test_no_more_is_said_than_what_is_enough() -> None:
    silhouettes, camera = of_a_sphere(6, 128)
    wanted, enough = np.ones((128, 128), bool), np.random.default_rng(0).random((128, 128)).astype(np.float32)
    whole, found = cover(silhouettes, camera, wanted), cover(silhouettes, camera, wanted, enough)
    np.testing.assert_array_equal(np.minimum(found, enough), np.minimum(whole, enough))
    assert (found < whole).any(), "walks end early"


def grown(mask: np.ndarray, px: int) -> np.ndarray:
    return cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * px + 1,) * 2))


@pytest.mark.parametrize("lit", [1.0, 0.0, None])
def test_clipping_with_a_margin_takes_what_lies_beyond_wider_masks_alone(lit: float | None) -> None:
    rig, margin, everywhere = ring(16, (96, 96), 90.0), 6, np.ones((96, 96), np.float32)
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(1, 16)}
    silhouettes, camera = agreed(rig, masks), seen_by(rig, 0)
    exact, inner, outer = (
        cover(agreed(rig, {v: grown(m, px) for v, m in masks.items()}), camera, everywhere > 0) > 0.5
        for px in (0, margin - 1, margin + 1)
    )
    grey = np.repeat(everywhere[..., None], 3, axis=2) / 2
    color, alpha = retouched(grey, everywhere, silhouettes, camera, lit, None, silhouettes.wider(margin))
    assert (alpha[exact] > 0.99).all()
    assert (alpha[inner] > 0.5).all(), "a disc of pixels and a distance differ by less than a px"
    assert (alpha[~outer] < 0.5).all()
    assert inner.mean() > exact.mean() + 0.1, "the margin is no trifle"
    assert outer.mean() < 0.7, "something is clipped"
    np.testing.assert_allclose(color, np.repeat(alpha[..., None] / 2, 3, axis=2), atol=1e-6)
    untouched = retouched(grey, everywhere, silhouettes, camera, lit, None, None)[1]
    np.testing.assert_array_equal(untouched, everywhere)


def test_estimated_masks_clip_at_the_same_share_of_every_camera_s_picture() -> None:
    """Whatever the pictures of other cameras are: those of two are half as large."""
    rig = ring(4, (96, 96), 90.0)
    rig.intrinsics[2:, :2] /= 2
    rig.size[2:] //= 2
    masks = np.stack([np.pad(m, (0, 96 - len(m))) for m in (sphere_mask(rig, v, CENTRE, RADIUS) for v in range(4))])
    params = RenderingParams()
    inputs: Any = MemoryInputs(
        stage("rendering"),
        params,
        {"frames/mask": masks[None]},
        rig,
        Views(rig.names, tuple(range(4)), ()),
        range(1),
        1,
        effects=frozenset({"silhouette_clipping"}),
    )
    bounds = FrameRenderer(MapReader(inputs), 0, params).bounds
    assert bounds is not None
    wider = agreed(rig, dict(enumerate(masks))).distance - bounds.distance
    for v, longest in enumerate((96, 96, 48, 48)):
        np.testing.assert_allclose(wider[v, :longest, :longest], UNSURE * longest, rtol=1e-3)
