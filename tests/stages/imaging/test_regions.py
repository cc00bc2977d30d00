"""Regions and crops: points there and back, half a pixel in its place, and pictures sampled where the points say."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.imaging.regions import (
    around,
    crop,
    crop_to_own,
    own_to_crop,
    own_to_picture,
    region_of,
    squares,
    to_own,
    to_picture,
    whole,
)

REGION = np.array([61.3, 47.8, 40.5, 0.4])


def test_points_go_there_and_back() -> None:
    points = np.random.default_rng(0).uniform(-50, 200, (30, 2))
    assert np.allclose(to_picture(to_own(points, REGION), REGION), points, atol=1e-9)


def test_the_middle_is_the_centre_and_corners_lie_half_a_side_off() -> None:
    assert np.allclose(to_picture(np.array([[0.5, 0.5]]), REGION), REGION[:2])
    corners = to_picture(np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), REGION)
    assert np.allclose(np.linalg.norm(np.roll(corners, -1, 0) - corners, axis=1), REGION[2])


def test_a_positive_angle_leans_to_the_right() -> None:
    up = to_picture(np.array([[0.5, 0.0]]), np.array([0, 0, 2, np.pi / 2]))
    assert np.allclose(up, [[1, 0]])


def test_own_to_picture_is_the_affine_of_to_picture_for_many_regions() -> None:
    regions = np.stack([REGION, REGION * 2])
    points = np.random.default_rng(1).uniform(0, 1, (5, 2))
    for m, r in zip(own_to_picture(regions), regions, strict=True):
        assert np.allclose(points @ m[:, :2].T + m[:, 2], to_picture(points, r))


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.5, 3.0])
def test_a_body_s_region_points_from_its_centre_to_its_rim(angle: float) -> None:
    centre = np.array([30.0, 40.0])
    rim = centre + 16 * np.array([np.sin(angle), -np.cos(angle)])
    region = region_of(centre, rim)
    assert np.allclose(region, [30, 40, 2 * 1.25 * 16, angle])
    # the rim is straight above the centre in the region's own coordinates, at 1 / (2 x 1.25) of its side
    assert np.allclose(to_own(rim[None], region), [[0.5, 0.5 - 0.4]])


def ramps(width: int, height: int) -> np.ndarray:
    """A picture whose first two channels are each pixel's own column and row."""
    v, u = np.mgrid[:height, :width]
    return np.stack([u, v, np.zeros_like(u)], axis=-1).astype(np.uint8)


@pytest.mark.parametrize(("size", "share"), [((24, 24), np.ones(2)), ((18, 24), np.array([0.75, 1.0]))])
def test_a_crop_shows_what_lies_at_its_cells_centres(size: tuple[int, int], share: np.ndarray) -> None:
    cut = crop(ramps(120, 100), REGION, size, share=share).astype(float)
    j, i = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    at = to_picture(crop_to_own((np.stack([j, i], -1).reshape(-1, 2) + 0.5) / size, share), REGION) - 0.5
    # values are rounded to whole numbers, and OpenCV's weights to 1/32: over all cells that averages out
    error = cut[..., :2].reshape(-1, 2) - at
    assert np.abs(error).max() < 0.6
    assert np.abs(error.mean(0)).max() < 0.05


def test_a_fine_picture_is_averaged_not_skipped() -> None:
    stripes = np.zeros((200, 200, 3), np.uint8)
    stripes[:, ::2] = 200
    cut = crop(stripes, np.array([100, 100, 160, 0.0]), (20, 20))
    assert np.abs(cut.astype(int) - 100).max() <= 2


def test_a_shrunken_crop_lies_where_the_plain_one_does() -> None:
    """A dot's centre of gravity, seen through a crop seven times as coarse,
    comes back to a three-hundredth of a cell."""
    v, u = np.mgrid[:301, :277] + 0.5
    dot = np.array([140.4, 133.3])
    picture = np.repeat((250 * np.exp(-((u - dot[0]) ** 2 + (v - dot[1]) ** 2) / (2 * 25**2)))[..., None], 3, 2).astype(
        np.uint8
    )
    region = np.array([135.0, 140.0, 224.0, 0.3])
    cut = crop(picture, region, (32, 32))[..., 0].astype(float)
    i, j = np.mgrid[:32, :32]
    centre = np.array([(cut * (j + 0.5)).sum(), (cut * (i + 0.5)).sum()]) / cut.sum() / 32
    # what 8 bits take of a dot of 25 px
    assert np.abs(to_picture(centre[None], region)[0] - dot).max() < 0.02


def test_points_drawn_in_a_picture_are_found_in_the_crop() -> None:
    """A known affine round trip to 1e-3 px:
    the picture's Gaussian dot, cut out of a float picture, fitted in the crop."""
    v, u = np.mgrid[:120, :120] + 0.5
    dot = np.array([63.2, 49.7])
    picture = np.exp(-((u - dot[0]) ** 2 + (v - dot[1]) ** 2) / (2 * 6.0**2)).astype(np.float32)
    cut = crop(np.repeat(picture[..., None], 3, 2), REGION, (64, 64))[..., 0].astype(float)
    i, j = np.mgrid[:64, :64] + 0.5
    own = np.stack([j, i], -1).reshape(-1, 2) / 64
    good = cut.ravel() > 0.2
    d = own[good] - 0.5
    design = np.stack([np.ones(len(d)), d[:, 0], d[:, 1], d[:, 0] ** 2, d[:, 0] * d[:, 1], d[:, 1] ** 2], 1)
    _, bx, by, cxx, cxy, cyy = np.linalg.lstsq(
        design * cut.ravel()[good, None], np.log(cut.ravel()[good]) * cut.ravel()[good], rcond=None
    )[0]
    top = np.linalg.solve([[2 * cxx, cxy], [cxy, 2 * cyy]], [-bx, -by]) + 0.5
    # bilinear sampling flattens a dot of 6 px evenly on all sides
    assert np.abs(to_picture(top[None], REGION)[0] - dot).max() < 1e-3


def test_outside_is_black_or_as_asked() -> None:
    white = np.full((20, 20, 3), 255, np.uint8)
    region = np.array([0, 10, 20, 0.0])
    assert (crop(white, region, (16, 16))[:, :7] == 0).all()
    assert (crop(white, region, (16, 16), cv2.BORDER_REPLICATE) == 255).all()


def test_the_whole_picture_is_a_letterbox() -> None:
    assert np.allclose(whole((1080, 1920)), [540, 960, 1920, 0])


@pytest.mark.parametrize("size", [(1080, 1920), (1920, 1080), (1280, 720), (3000, 500)])
def test_squares_cover_the_long_side_and_overlap(size: tuple[int, int]) -> None:
    found = squares(size)
    along = found[:, 0] if size[0] > size[1] else found[:, 1]
    assert (found[:, 2] == min(size)).all()
    assert np.isclose(along[0], min(size) / 2)
    assert np.isclose(along[-1], max(size) - min(size) / 2)
    assert (np.diff(along) <= min(size) / 2 + 1e-9).all()


def test_a_nearly_square_picture_needs_no_squares() -> None:
    assert squares((512, 512)).shape == (0, 4)
    assert squares((600, 512)).shape == (0, 4)


def test_smaller_squares_cover_the_whole_picture() -> None:
    found = squares((1080, 1920), 0.5)
    assert (found[:, 2] == 540).all()
    assert len(found) == 3 * 7
    for point in np.random.default_rng(0).uniform((0, 0), (1080, 1920), (50, 2)):
        assert (np.abs(found[:, :2] - point) <= 270).all(1).any()


def test_around_a_box() -> None:
    assert np.allclose(around(np.array([10, 20, 30, 60])), [20, 40, 50, 0])


def test_a_crop_and_its_region_convert_into_each_other() -> None:
    shares, share = np.random.default_rng(0).uniform(-0.5, 1.5, (50, 2)), np.array([0.75, 1.0])
    np.testing.assert_allclose(own_to_crop(crop_to_own(shares, share), share), shares, atol=1e-15)
    np.testing.assert_array_equal(crop_to_own(np.array([0.0, 1.0]), share), [0.125, 1.0])
