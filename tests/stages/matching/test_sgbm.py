"""One pair on a textured sphere: the residual formula, both orders, and the guide's irrelevance for the result."""

import cv2
import numpy as np
import pytest

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
