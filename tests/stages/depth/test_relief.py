"""A relief: known shapes, and what it must not depend on."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.depth.algorithms.relief import GUESSED, relief

FOCAL, FAR = 400.0, 2.0


def capsules(scale: int = 1) -> np.ndarray:
    """A silhouette of a wide body and two thin limbs."""
    mask = np.zeros((200 * scale, 160 * scale), np.uint8)
    mask[40 * scale : 120 * scale, 55 * scale : 105 * scale] = 255
    mask[119 * scale : 180 * scale, 60 * scale : 72 * scale] = 255
    mask[119 * scale : 180 * scale, 88 * scale : 100 * scale] = 255
    return mask


def bulge(mask: np.ndarray, focal: float = FOCAL) -> np.ndarray:
    """[h, w] px towards the camera."""
    depth, _ = relief(mask, FAR, focal)
    return np.where(depth > 0, (1 - depth / FAR) * focal, 0)


def test_a_limb_is_a_round_cylinder() -> None:
    mask = capsules()
    found = bulge(mask)[150, 60:72]
    expected = np.sqrt(
        np.maximum(6.5**2 - (np.arange(12) - 5.5) ** 2, 0)
    )  # u is 0 at the centres of the pixels outside
    # Thinner than round by a few percent: the limb is not infinitely narrower than l.
    np.testing.assert_allclose(found, expected, rtol=0.2)
    assert (found <= expected + 1e-3).all()


def test_a_body_is_flatter_than_wide() -> None:
    found = bulge(capsules())
    assert found[80, 80] > 1.5 * found[150, 66]
    assert found[80, 80] < 25, "half its width"


def test_depth_is_nowhere_else_and_nowhere_certain() -> None:
    mask = capsules()
    depth, confidence = relief(mask, FAR, FOCAL)
    np.testing.assert_array_equal(depth > 0, mask > 127)
    np.testing.assert_array_equal(confidence, np.where(mask > 127, np.float32(GUESSED), 0))
    assert depth.max() <= FAR


def test_twice_the_resolution_gives_the_same_shape() -> None:
    small, large = bulge(capsules()), bulge(capsules(2), 2 * FOCAL) / 2
    reduced = cv2.resize(large, (160, 200), interpolation=cv2.INTER_AREA)
    inside = cv2.erode(capsules(), np.ones((5, 5), np.uint8)) > 0
    np.testing.assert_allclose(
        reduced[inside], small[inside], atol=0.6
    )  # the outline is half a pixel farther out in the smaller one


def test_the_distance_scales_all_depths() -> None:
    near, far = (relief(capsules(), d, FOCAL)[0] for d in (1.0, 3.0))
    np.testing.assert_allclose(far, 3 * near, rtol=1e-6)  # float32


def test_the_sweeps_suffice() -> None:
    """The discrete equation holds at every pixel."""
    mask = capsules()
    u = bulge(mask, 1e6) ** 2  # a long focal length keeps what float32 depth resolves: 1e6 * 6e-8 px
    inside, width = mask > 127, 0.11 * np.sqrt((mask > 127).sum())
    around = sum(np.roll(u, s, a) for s in (1, -1) for a in (0, 1))
    left = (around - 4 * u - u / width**2 + 2)[inside]
    assert np.abs(left).max() < 12  # u is some 400 px^2, and 1.0 of it is rounding
    assert abs(left.mean()) < 0.05


def test_a_body_that_goes_on_beyond_the_picture_is_not_rounded_there() -> None:
    mask = np.zeros((60, 80), np.uint8)
    mask[20:, 30:50] = 255
    found = bulge(mask)
    np.testing.assert_allclose(found[59, 30:50], found[45, 30:50], rtol=0.02)
    assert found[20, 40] < 0.6 * found[59, 40]


@pytest.mark.parametrize("value", [0, 255])
def test_nobody_is_nothing_and_a_full_picture_a_plane(value: int) -> None:
    depth, confidence = relief(np.full((10, 12), value, np.uint8), FAR, FOCAL)
    assert (depth == (FAR if value else 0)).all()
    assert (confidence > 0).all() == bool(value)


def test_a_huge_silhouette_keeps_in_front_of_the_camera() -> None:
    mask = np.zeros((100, 100), np.uint8)
    mask[1:-1, 1:-1] = 255
    assert relief(mask, FAR, 2.0)[0][1:-1, 1:-1].min() >= FAR / 2
