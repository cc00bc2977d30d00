"""How far pictures reach once their lenses are undone: as far as they were filmed, and no farther."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.imaging.camera_mapping import (
    BORDER,
    WIDEST,
    captured_positions,
    frames_positions,
    frames_rig,
    left_out,
    undistorted,
    unreduced_size,
)
from posegaussian.stages.imaging.noise import size_worked_at
from posegaussian.stages.imaging.warp import Warp
from posegaussian.storage.model.cameras import Rig

WHOLE = np.array([[1.0, 0.0, 0.0]])
ACTION = (620.0, (960, 720), (-0.26, 0.09, 0, 0, -0.014))
"""Focal length px, size and lens of a wide action camera."""
BARREL = {
    "action camera": ACTION,
    "strong": (400.0, (500, 375), (-0.3, 0.12, 0.001, -0.001, 0)),
    "mild": (1000.0, (1000, 562), (-0.1,)),
    "rational": (350.0, (480, 360), (0.5, 0.2, 0.0005, 0.0003, 0.05, 0.8, 0.3, 0.1)),
    "upright": (560.0, (375, 500), (-0.2, 0.05)),
}


def camera(focal: float, size: tuple[int, int], lens: tuple[float, ...], aside: tuple[float, float] = (0, 0)) -> Rig:
    """One camera whose principal point lies `aside` px from the middle."""
    k = np.array([[focal, 0, size[0] / 2 + aside[0]], [0, focal, size[1] / 2 + aside[1]], [0, 0, 1]])
    d = np.array([[*lens, *[0.0] * (8 - len(lens))]])
    return Rig(("a",), k[None], d, np.eye(4)[None], np.array([size]))


def seen_of(
    source: Rig, longest: int | None = None, captured: tuple[int, int] | None = None, crop: np.ndarray = WHOLE
) -> Rig:
    filmed = source.size if captured is None else np.array([captured])
    return undistorted(frames_rig(source, longest), source, filmed, crop)


def kept(source: Rig, rig: Rig) -> float:
    """Share of the captured pixels that lie in the pictures of a rig."""
    pixels = pixel_centres((int(source.size[0, 0]), int(source.size[0, 1])))[::4, ::4]
    at = frames_positions(pixels, rig.intrinsics[0], source.intrinsics[0], source.distortion[0], WHOLE[0])
    return float(np.all((at >= 0) & (at <= rig.size[0]), axis=-1).mean())


@pytest.mark.parametrize("lens", BARREL.values(), ids=BARREL)
@pytest.mark.parametrize("aside", [(0.0, 0.0), (37.3, -21.6)])
def test_a_picture_reaches_as_far_as_it_was_filmed_and_every_pixel_of_it_was(
    lens: tuple[float, tuple[int, int], tuple[float, ...]], aside: tuple[float, float]
) -> None:
    """The nearest point of every side of the captured picture lies within a pixel of the undistorted one's."""
    source = camera(*lens, aside)
    seen = seen_of(source)
    np.testing.assert_array_equal(seen.intrinsics[:, :2, :2], source.intrinsics[:, :2, :2])
    assert not seen.distortion.any()
    (w, h), t = source.size[0], np.linspace(0, 1, 4 * BORDER)
    (width, height), lens_of = seen.size[0], (seen.intrinsics[0], source.intrinsics[0], source.distortion[0], WHOLE[0])
    side = {a: np.stack([t * w, np.full_like(t, a)], axis=-1) for a in (0, h)}
    across = {a: np.stack([np.full_like(t, a), t * h], axis=-1) for a in (0, w)}
    assert 0 >= frames_positions(side[0], *lens_of)[:, 1].max() - 0.01 > -1.02
    assert 0 <= frames_positions(side[h], *lens_of)[:, 1].min() - height + 0.01 < 1.02
    assert 0 >= frames_positions(across[0], *lens_of)[:, 0].max() - 0.01 > -1.02
    assert 0 <= frames_positions(across[w], *lens_of)[:, 0].min() - width + 0.01 < 1.02
    for longest in (None, 240, 97):
        warp = Warp(0, (w, h), source, seen_of(source, longest), WHOLE[0])
        assert (warp.coverage == 255).all()
        assert warp(np.full((h, w), 200, np.uint8)).min() == 200


def test_what_a_wide_lens_films_at_its_rim_is_kept() -> None:
    """24 % of the pixels lay beyond a picture of the calibrated size; the tips of the corners still do."""
    source = camera(*ACTION)
    assert kept(source, frames_rig(source, None)) == pytest.approx(0.76, abs=0.01)
    seen = seen_of(source)
    assert kept(source, seen) == pytest.approx(0.93, abs=0.01)
    assert left_out(source, 0) == pytest.approx(1 - kept(source, seen), abs=0.005)


@pytest.mark.parametrize(
    ("focal", "lens"),
    [(600.0, ()), (600.0, (0.1,)), (600.0, (-1.0,))],
    ids=["no lens", "pincushion", "folds back in the corners"],
)
def test_a_lens_that_shows_no_more_leaves_the_picture_as_it_is(focal: float, lens: tuple[float, ...]) -> None:
    source = camera(focal, (640, 480), lens, (3.3, -2.1))
    seen = seen_of(source)
    np.testing.assert_array_equal(seen.intrinsics, source.intrinsics)
    np.testing.assert_array_equal(seen.size, source.size)
    for longest in (17, 100, 333, 639):
        np.testing.assert_array_equal(unreduced_size(frames_rig(source, longest), source), source.size)
    assert left_out(source, 0) == pytest.approx(0.0 if lens != (-1.0,) else 1 - kept(source, source), abs=0.01)


@pytest.mark.parametrize("longest", [None, 384, 300])
def test_a_wider_picture_is_as_sharp(longest: int | None) -> None:
    """Noise in the middle, where a mild lens moves nothing: the same pixels, not what lies between them."""
    source = camera(512.0, (512, 512), (-0.1,))
    picture = np.random.default_rng(0).integers(0, 256, (512, 512), dtype=np.uint8)
    contrast = []
    for rig in (frames_rig(source, longest), seen_of(source, longest)):
        (x, y), (w, h) = rig.size[0] // 2 - 20, (40, 40)
        contrast.append(float(Warp(0, (512, 512), source, rig, WHOLE[0])(picture)[y : y + h, x : x + w].std()))
    assert contrast[1] == pytest.approx(contrast[0], rel=0.04)


def test_a_fisheye_grows_by_half_at_most() -> None:
    source = camera(400.0, (640, 480), (0.08, 0, 0, 0, 0, 0.5))
    seen = seen_of(source)
    assert (seen.size <= WIDEST * source.size).all()
    assert seen.size[0, 0] == int(WIDEST * source.size[0, 0])
    assert (Warp(0, (640, 480), source, seen, WHOLE[0]).coverage == 255).all()


@pytest.mark.parametrize("rows", [470, 500])
def test_a_letterboxed_picture_grows_where_it_was_filmed_alone(rows: int) -> None:
    """Pictures of more or fewer rows than the calibrated one: what no picture shows does not become more."""
    source, crop = camera(620.0, (640, 480), (-0.2,)), np.array([[1.0, 0.0, (480 - rows) / 2]])
    seen = seen_of(source, None, (640, rows), crop)
    assert seen.size[0, 0] > source.size[0, 0]
    assert (Warp(0, (640, rows), source, seen, crop[0]).coverage == 255).all()
    assert (seen.size[0, 1] > seen_of(source).size[0, 1]) == (rows > 480)


def waves(pixels: np.ndarray) -> np.ndarray:
    """Grey at pixels [..., 2], 28 to 228."""
    return np.asarray(128 + 100 * np.prod(np.sin(2 * np.pi * pixels / 60 + [0.0, 1.0]), axis=-1))


@pytest.mark.parametrize("longest", [None, 600])
def test_colours_and_depth_lie_where_the_wider_camera_sees_them(longest: int | None) -> None:
    """Against OpenCV's own lens; waves of 60 px, of which half a pixel beside their place costs 2 to 4 in the mean."""
    source = camera(*ACTION, (12.4, -7.7))
    (w, h), rig = source.size[0], seen_of(source, longest)
    warp = Warp(0, (w, h), source, rig, WHOLE[0])
    frame_size = (int(rig.size[0, 0]), int(rig.size[0, 1]))
    k = rig.intrinsics[0]
    ideal = (pixel_centres(frame_size) - k[:2, 2]) / k[[0, 1], [0, 1]]
    rays = np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=-1).reshape(-1, 1, 3)
    at = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), source.intrinsics[0], source.distortion[0])[0]
    expected = waves(at.reshape(ideal.shape))
    assert np.abs(warp(waves(pixel_centres((w, h))).round().astype(np.uint8)) - expected).mean() < 0.8
    far = warp.depth((1 + pixel_centres((w, h))[..., 0] / 1000).astype(np.float32))
    np.testing.assert_allclose(far, 1 + at.reshape(ideal.shape)[..., 0] / 1000, atol=2e-4)


def test_pixels_worked_on_are_counted_at_the_calibrated_resolution() -> None:
    source = camera(*ACTION)
    seen = seen_of(source)
    np.testing.assert_array_equal(unreduced_size(seen, source), seen.size)
    assert size_worked_at(seen, source, WHOLE) == pytest.approx(1.0)
    half = seen_of(source, 480)
    np.testing.assert_array_equal(unreduced_size(half, source), seen.size)
    assert size_worked_at(half, source, WHOLE) == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(half.intrinsics[:, :2, :2], source.intrinsics[:, :2, :2] / 2, rtol=1e-3)
    assert np.abs(2 * half.size - seen.size).max() <= 1
    ideal = np.array([0.31, -0.17, 1.0])
    pixel = (half.intrinsics[0] @ ideal)[:2]
    whole = (seen.intrinsics[0] @ ideal)[:2]
    where = [
        captured_positions(p, r.intrinsics[0], source.intrinsics[0], source.distortion[0], WHOLE[0])
        for p, r in ((pixel, half), (whole, seen))
    ]
    np.testing.assert_allclose(*where, atol=1e-6)
