"""What the network is shown: starts that mean the same point in space as the depth they come from,
matches, evidence, windows."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from posegaussian.stages.geometry.projection import pixel_centres, project
from posegaussian.stages.geometry.rectification import STRETCH, Window
from posegaussian.stages.network.model.pairs import (
    APART,
    MARGIN,
    PairViews,
    SourceView,
    evidence,
    others,
    rectified_pair,
    relief,
    sampled,
    start_on,
    too_large,
    window_around,
    windows,
)
from tests.support.known_geometry import camera, on_ring, rig_of, sphere_depth
from tests.support.network_views import UPRIGHT, pair_of, plane_depth, plane_disparity, source, two_cameras

torch.set_num_threads(1)
SHIFTED: tuple[Window, Window] = ((11, -5, 96, 104), (-20, -5, 96, 104))
"""Neither at the frame's corner nor at equal columns."""


def inner(known: torch.Tensor, px: int = 4) -> torch.Tensor:
    """[B, 1, H, W] bool: pixels whose surroundings are known, too."""
    return -torch.nn.functional.max_pool2d(-known.float(), 2 * px + 1, stride=1, padding=px) > 0


def plane_views(moved: float = 0.0) -> PairViews:
    """Both directions over the plane; the first view's start is off by so many px."""
    rig = two_cameras()
    pair, depths = pair_of(rig), [plane_depth(rig, v) for v in (0, 1)]
    around = windows(pair, (depths[0] > 0, depths[1] > 0), 8)
    assert around is not None
    views = rectified_pair(pair, (source(rig, 0, depths[0]), source(rig, 1, depths[1])), around)
    start = views.start.clone()
    start[0] += moved
    return replace(views, start=start)


@pytest.mark.parametrize("which", [0, 1])
def test_a_start_is_the_disparity_of_the_point_that_the_depth_means(which: int) -> None:
    """A picture of one depth: which of its pixels is the nearest does not matter. Float32 keeps 3e-5 px of 300."""
    rig = two_cameras()
    pair = pair_of(rig)
    found = start_on(pair, which, SHIFTED[which], SHIFTED[1 - which], np.full((128, 128), 1.9, np.float32))
    window, other = SHIFTED[which], SHIFTED[1 - which]
    pixels = pixel_centres(window[2:]) + np.array(window[:2])
    places, _ = pair.source_pixels(which, pixels)
    rays = np.concatenate([places, np.ones((*places.shape[:2], 1))], axis=-1) @ np.linalg.inv(rig.intrinsics[which]).T
    pose = rig.world_to_camera[which]
    points = (1.9 * rays - pose[:3, 3]) @ pose[:3, :3]
    there, _ = project(points, pair.intrinsics[1 - which], pair.world_to_camera(1 - which))
    inside = np.isfinite(found)
    beside = ((places < -0.01) | (places > 128.01)).any(axis=-1)
    assert inside.mean() > 0.3
    assert not inside[beside].any()
    expected = (pixels[..., 0] - window[0]) - (there[..., 0] - other[0])
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-3)
    np.testing.assert_allclose(there[..., 1], pixels[..., 1], atol=1e-9)  # a pair's rows are shared


@pytest.mark.parametrize("surface", ["plane", "sphere"])
def test_a_start_leads_back_to_its_depth_in_both_directions(surface: str) -> None:
    rig = two_cameras()
    pair = pair_of(rig)
    depths = [
        plane_depth(rig, v) if surface == "plane" else sphere_depth(rig, v, np.zeros(3), 0.4).astype(np.float32)
        for v in (0, 1)
    ]
    views = rectified_pair(pair, (source(rig, 0, depths[0]), source(rig, 1, depths[1])), SHIFTED)
    back = views.coding.depth(views.start)[:, 0].double().numpy()
    for which in (0, 1):
        places, ratio = pair.source_pixels(which, pixel_centres(SHIFTED[which][2:]) + np.array(SHIFTED[which][:2]))
        cells = np.floor(places).astype(int)
        held = ((cells >= 0) & (cells < 128)).all(axis=-1)
        expected = np.where(held, depths[which][cells[..., 1].clip(0, 127), cells[..., 0].clip(0, 127)], 0)
        known = np.isfinite(back[which])
        # float32 of a disparity of 300 px is 3e-5 px, 2e-7 of the depth; a place on the line between two pixels may
        # fall to either
        off = np.abs(back[which] * ratio - expected)[known]
        assert np.mean(off > 2e-6) < 1e-3
        assert np.mean(known != (expected > 0)) < 1e-3


def test_others_are_the_other_view_of_the_same_pair() -> None:
    x = torch.arange(12.0).reshape(6, 2)
    assert others(x).tolist() == x[[1, 0, 3, 2, 5, 4]].tolist()
    assert torch.equal(others(others(x)), x)


def test_the_other_picture_at_the_true_match_shows_the_same_and_elsewhere_it_does_not() -> None:
    views = plane_views()
    start, sure = views.start.nan_to_num(), inner(views.known)
    right, wrong = (
        (sampled(others(views.color), start + px) - views.color).abs().mean(1, keepdim=True)[sure] for px in (0.0, 6.0)
    )
    # 8 bits, two interpolations of waves of 25 px and depths of the nearest pixel: 1 of 255 on average
    assert float(right.mean()) < 0.008
    assert float(wrong.mean()) > 10 * float(right.mean())


def test_sampling_is_exact_on_a_ramp_and_holds_the_rim() -> None:
    ramp = (torch.arange(10.0) + 0.5).expand(1, 1, 4, 10)
    found = sampled(ramp, torch.full((1, 1, 4, 10), 2.25))
    torch.testing.assert_close(found[0, 0, 0], (torch.arange(10.0) + 0.5 - 2.25).clamp(0.5, 9.5))
    nearest = sampled(ramp, torch.full((1, 1, 4, 10), 2.25), nearest=True)
    torch.testing.assert_close(nearest[0, 0, 0, 3:], torch.arange(10.0)[3:] + 0.5 - 2)


def test_evidence_is_small_where_the_start_is_right_and_large_where_it_is_wrong() -> None:
    right, wrong = plane_views(), plane_views(moved=2 * APART + 4)
    sure = inner(right.known)[:1]
    good, bad = evidence(right)[:1], evidence(wrong)[:1]
    assert good.shape[1] == 5
    assert float(good[:, 3:4][sure].mean()) < 0.008
    assert float(good[:, 4:5][sure].max()) < 0.1  # 0.8 px: both sides are depths of the nearest pixel
    assert float(bad[:, 3:4][sure].mean()) > 0.1
    # what matches nothing any more, and what disagrees by 20 px, counts 2
    torch.testing.assert_close(bad[:, 4:5][sure], torch.full_like(bad[:, 4:5][sure], 2.0))
    for found, views in ((good, right), (bad, wrong)):
        torch.testing.assert_close(
            found[:, :3], torch.cat([views.known[:1].float(), views.confidence[:1], views.cover[:1]], dim=1)
        )


def test_evidence_of_starts_that_are_not_there_is_finite_and_nothing() -> None:
    views = plane_views()
    start = views.start.clone()
    start[:, :, :, ::3] = torch.nan
    start[1] = torch.nan
    found = evidence(replace(views, start=start))
    assert torch.isfinite(found).all()
    unknown = ~torch.isfinite(start)
    for channel in (0, 3, 4):
        assert not found[:, channel : channel + 1][unknown].any()
    # a start whose other view knows nothing is neither confirmed nor refuted: as bad as it gets
    assert (found[:1, 4:5][~unknown[:1]] == 2).all()


def test_relief_forgets_the_offset_and_means_nothing_where_nothing_is_known() -> None:
    disparity = torch.rand(2, 1, 8, 8, generator=torch.Generator().manual_seed(0)) * 20
    known = torch.ones(2, 1, 8, 8, dtype=torch.bool)
    known[0, :, :3], known[1] = False, False
    found = relief(disparity, known)
    assert not found[~known].any()
    assert float(found[known].mean()) == pytest.approx(0, abs=1e-6)
    torch.testing.assert_close(relief(disparity + 300, known), found, rtol=0, atol=1e-5)  # float32 of 320 px
    torch.testing.assert_close(relief(torch.where(known, disparity, torch.nan), known), found)


@pytest.mark.parametrize("multiple", [4, 8, 16])
def test_windows_hold_both_subjects_with_a_margin_at_equal_size_and_rows(multiple: int) -> None:
    rig = two_cameras()
    pair = pair_of(rig)
    inside = np.zeros((2, 128, 128), bool)
    inside[0, 30:90, 40:60], inside[1, 20:75, 35:80] = True, True
    found = windows(pair, (inside[0], inside[1]), multiple)
    assert found is not None
    assert found[0][1:] == found[1][1:]
    assert found[0][2] % multiple == found[0][3] % multiple == 0
    for which, (x0, y0, width, height) in enumerate(found):
        rows, columns = np.nonzero(inside[which])
        pixels, _ = pair.rectified_pixels(which, np.stack([columns, rows], axis=-1) + 0.5)
        assert (pixels >= np.array([x0, y0]) + MARGIN).all()
        assert (pixels <= np.array([x0 + width, y0 + height]) - MARGIN).all()


def test_a_blob_at_the_rim_of_a_wide_lens_leaves_the_window_on_the_subject() -> None:
    cameras = [camera(on_ring(a), np.zeros(3)) for a in (0.0, 84.0)]
    pair = pair_of(rig_of(cameras, (128, 128), focal=64.0))
    inside = np.zeros((2, 128, 128), bool)
    inside[:, 30:98, 50:78] = True
    plain = windows(pair, (inside[0], inside[1]), 8)
    assert plain is not None
    assert not any(too_large(pair, w) for w in plain)
    for which, columns in enumerate((slice(-2, None), slice(0, 2))):
        inside[which, 60:62, columns] = True
        pixels, ratio = pair.rectified_pixels(which, np.array([127.0 * (which == 0), 61.0]))
        assert ratio > 0
        assert abs(pixels[0] - plain[which][0]) > 5 * 128  # far beyond both pictures
    assert windows(pair, (inside[0], inside[1]), 8) == plain
    assert window_around(pair, inside[0], 8) == window_around(pair, inside[0] & (np.arange(128) < 100), 8)


def test_a_window_of_many_pictures_is_too_large() -> None:
    pair = pair_of(two_cameras())
    side = int(128 * STRETCH**0.5)
    assert not too_large(pair, (-400, 0, side, side))
    assert too_large(pair, (-400, 0, side + 1, side + 1))


@pytest.mark.parametrize("empty", [0, 1])
def test_a_view_without_a_subject_has_no_window(empty: int) -> None:
    inside = [np.ones((128, 128), bool), np.ones((128, 128), bool)]
    inside[empty][:] = False
    assert windows(pair_of(two_cameras()), (inside[0], inside[1]), 8) is None


def test_views_are_the_rectified_pictures_of_both_and_batches_keep_them_apart() -> None:
    rig = two_cameras()
    pair, depths = pair_of(rig), [plane_depth(rig, v) for v in (0, 1)]
    sources = [source(rig, v, depths[v]) for v in (0, 1)]
    views = rectified_pair(pair, (sources[0], sources[1]), SHIFTED)
    for which in (0, 1):
        exact = plane_disparity(pair, which, SHIFTED[which], SHIFTED[1 - which], UPRIGHT)
        known = views.known[which, 0].numpy()
        # the depth of the nearest pixel is off by up to half a pixel of the plane's slope
        assert np.abs(views.start[which, 0].numpy() - exact)[known].max() < 0.3
    assert not views.heatmaps.any()  # a capture without joints
    assert not views.confidence[~views.known].any()
    both = PairViews.batch([views, plane_of_other_start(views)])
    assert torch.equal(both.color[2:], views.color)
    torch.testing.assert_close(both.coding.scale, views.coding.scale.repeat(2))
    low, high = both.coding.bounds()
    assert (both.start.nan_to_num(float(low[0])) >= low.min()).all()
    assert (both.start.nan_to_num(float(low[0])) <= high.max()).all()


def plane_of_other_start(views: PairViews) -> PairViews:
    return replace(views, start=views.start + 0.5)


def test_two_views_without_any_depth_are_shown_as_unknown() -> None:
    rig = two_cameras()
    nothing = SourceView(
        np.zeros((128, 128, 3), np.uint8),
        np.zeros((128, 128), np.uint8),
        np.zeros((128, 128), np.float32),
        np.zeros((128, 128), np.float16),
        None,
    )
    views = rectified_pair(pair_of(rig), (nothing, nothing), SHIFTED)
    assert not views.known.any()
    assert torch.isfinite(evidence(views)).all()
