"""One pair on a textured sphere: the residual formula, both orders, and the guide's irrelevance for the result."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.matching.sgbm import Bounds, match
from tests.support.known_geometry import ring, textured_sphere

CENTRE = np.zeros(3)


@pytest.mark.parametrize(("first", "second"), [(0, 1), (1, 0), (0, 15)])
@pytest.mark.parametrize("offset", [0.0, 0.08])
def test_true_depth_is_found_in_either_order_and_with_a_guide_that_is_off(
    first: int, second: int, offset: float
) -> None:
    rig = ring(16, (128, 112), 120.0)
    (color, truth), (other, _) = (textured_sphere(rig, v, CENTRE, 0.6) for v in (first, second))
    pair = rectify(rig, first, second, CENTRE, 1.5)
    surface = truth > 0
    guide = np.where(surface, truth - offset, 0).astype(np.float32)
    bounds = Bounds(
        guide,
        np.where(surface, truth - 0.2, 0).astype(np.float32),
        np.where(surface, truth + 0.2, 0).astype(np.float32),
    )
    depth = match(pair, color, other, surface, bounds)
    inner = cv2.erode(surface.astype(np.uint8), np.ones((15, 15))) > 0
    error = pair.sensitivity * np.abs(1 / depth[inner & (depth > 0)] - 1 / truth[inner & (depth > 0)])
    assert (depth[inner] > 0).mean() > 0.9
    # A sign error in the residual or a half pixel between the pictures is several times larger.
    assert np.median(error) < 0.25
    assert (depth[~surface] == 0).all()


def test_an_empty_mask_gives_nothing():
    rig = ring(16, (64, 48), 60.0)
    nothing = np.zeros((48, 64), np.float32)
    picture = np.zeros((48, 64, 3), np.uint8)
    assert not match(rectify(rig, 0, 1, CENTRE), picture, picture, nothing > 0, Bounds(nothing, nothing, nothing)).any()


def test_only_pixels_without_a_counterpart_lose_their_match() -> None:
    """The second picture is moved aside until it shows half of the ball: what both see is measured as before."""
    rig = ring(16, (128, 112), 120.0)
    (color, truth), (other, _) = (textured_sphere(rig, v, CENTRE, 0.6) for v in (0, 1))
    cut = 56
    k = rig.intrinsics.copy()
    k[1, 0, 2] -= cut
    half, left = replace(rig, intrinsics=k), np.zeros_like(other)
    left[:, :-cut] = other[:, cut:]
    surface = truth > 0
    bounds = Bounds(truth, *(np.where(surface, truth + d, 0).astype(np.float32) for d in (-0.2, 0.2)))
    whole = match(rectify(rig, 0, 1, CENTRE, 1.5), color, other, surface, bounds)
    part = match(rectify(half, 0, 1, CENTRE, 1.5), color, left, surface, bounds)
    world = unproject(truth, rig.intrinsics[0], rig.world_to_camera[0])
    seen = project(world, half.intrinsics[1], half.world_to_camera[1])[0]
    shown, hidden = surface & (seen[..., 0] > 8), surface & (seen[..., 0] < -2)
    assert min(shown.sum(), hidden.sum()) > 500
    found = unproject(part, rig.intrinsics[0], rig.world_to_camera[0])[part > 0]
    assert (project(found, half.intrinsics[1], half.world_to_camera[1])[0][:, 0] > -1).all()
    # A wrong match is left to the other direction.
    assert (part[hidden] > 0).mean() < 0.1
    # Windows at the cut see what is beside the picture.
    assert (part[shown] > 0).mean() > 0.97 * (whole[shown] > 0).mean()
    both = shown & (part > 0) & (whole > 0)
    assert np.median(np.abs(1 / part[both] - 1 / whole[both])) * rectify(rig, 0, 1, CENTRE).sensitivity < 0.05


def test_pictures_that_show_nothing_in_common_have_no_match() -> None:
    rig = ring(16, (128, 112), 120.0)
    (color, truth), (other, _) = (textured_sphere(rig, v, CENTRE, 0.6) for v in (0, 1))
    k = rig.intrinsics.copy()
    k[1, 0, 2] -= 500
    surface = truth > 0
    bounds = Bounds(truth, *(np.where(surface, truth + d, 0).astype(np.float32) for d in (-0.2, 0.2)))
    assert not match(rectify(replace(rig, intrinsics=k), 0, 1, CENTRE), color, other, surface, bounds).any()
