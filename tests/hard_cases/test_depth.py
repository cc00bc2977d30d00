"""The catalogue of rectification and depth: R1, R2, D1-D15 where the code is there. Bounds are in the records."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from posegaussian.stages.contract.io import Block
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.depth.run import check
from posegaussian.stages.geometry.pairs import choose_pairs, classify
from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.matching.bounds import Bounds, around, between, inverse, shifted
from posegaussian.stages.matching.fuse import complete, fuse
from posegaussian.stages.matching.sampling import extend, sample
from posegaussian.stages.matching.sgbm import match
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.images import read_depth, write_png
from tests.hard_cases.cases_depth import (
    OPPOSITE,
    ORIGIN,
    VERTICAL,
    WIDE,
    bounds_around,
    hidden_scene,
    lost,
    round_trip,
    sphere_scene,
    stereo_depth_error,
    wrong_where_hidden,
)
from tests.hard_cases.catalogue import named, run
from tests.support.known_geometry import rig_of, ring


def test_r1_baselines_that_run_any_way_get_common_rows() -> None:
    for rig in VERTICAL:
        assert classify(rig, 0, 1).usable
        assert choose_pairs(rig, (0, 1), 2) == {0: [1], 1: [0]}
        assert stereo_depth_error(rig) < 1e-9
    with pytest.raises(ValueError, match="stand 0 m apart"):
        rectify(rig_of([VERTICAL[0].world_to_camera[0]] * 2), 0, 1, ORIGIN)


def test_r2_pairs_are_matched_up_to_the_widest_angle_and_keep_the_body() -> None:
    assert [classify(r, 0, 1).usable for r in WIDE] == [True] * 6
    assert not any(classify(r, 0, 1).usable for r in OPPOSITE)
    assert max(lost(r) for r in WIDE) == 0


def test_d1_depth_in_integers_is_refused(tmp_path: Path) -> None:
    write_png(tmp_path / "depth.png", np.full((4, 4), 200, np.uint8))
    with pytest.raises(SourceError, match="uint8 values; depth is read from float"):
        read_depth(tmp_path / "depth.png")


@pytest.mark.parametrize("rig", WIDE[:3])
def test_d2_depth_survives_its_disparity_at_any_angle(rig: Rig) -> None:
    """Beside an offset of 1500 px, too: in float32 the farthest would come back wrong."""
    pair = rectify(rig, 0, 1, ORIGIN)
    depth = np.array([0.5, 1.5, 2.0, 50.0], np.float32)
    np.testing.assert_allclose(pair.depth(pair.disparity(depth)), depth, rtol=1e-12)


def test_d3_no_depth_is_0_in_every_step_and_what_is_impossible_is_refused() -> None:
    z = np.array([[0.0, 2.0]], np.float32)
    assert inverse(z).tolist() == [[0.0, 0.5]]
    assert shifted(z, -1.0)[0, 0] == between(z, z, 0.5)[0, 0] == 0
    assert np.isfinite(shifted(z, -1e9)).all()  # farther than infinity ends at a kilometre
    assert not fuse(np.zeros((1, 1, 1), np.float32), np.full((1, 1, 1), np.inf, np.float32), np.ones(1), 1.5)[0].any()
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="depth/depth of view 1"):
            check(Block("depth/depth", np.full((1, 2, 2), bad, np.float32), 1), DepthParams())


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0])
def test_d3_lifting_makes_nothing_of_impossible_depth_and_counts_it(bad: float) -> None:
    depth = torch.full((2, 2), 2.0, requires_grad=True)
    given = torch.where(torch.tensor([[True, False], [False, False]]), torch.tensor(bad), depth)
    lifted = lift(
        GaussianMaps(torch.ones(2, 2, 3), given, torch.ones(3, 2, 2), -torch.ones(3, 2, 2), torch.ones(2, 2, 2)),
        np.eye(3),
        np.eye(4),
        torch.float32,
        torch.device("cpu"),
    )
    lifted.mean.sum().backward()
    assert (len(lifted.mean), lifted.masked) == (3, int(not bad < 0))  # less than 0 is no surface, as 0 is
    assert depth.grad is not None
    assert torch.isfinite(depth.grad).all()


def test_d4_empty_mask_through_every_step() -> None:
    nothing, picture = np.zeros((48, 64), np.float32), np.zeros((48, 64, 3), np.uint8)
    pair = rectify(ring(16, (64, 48), 60.0), 0, 1, ORIGIN)
    assert not match(pair, picture, picture, nothing > 0, Bounds(nothing, nothing, nothing)).any()
    assert extend(nothing, nothing > 0) is nothing
    assert all(not part.any() for part in complete(nothing, nothing, nothing, nothing))
    assert not around(nothing, 0.1, nothing, nothing).far.any()


def test_d9_beside_the_picture_nothing_is_known() -> None:
    surface = np.full((4, 4), 2, np.float32)
    beside = np.array([[-1.0, 4.0, -1e9, np.nan]])
    assert not sample(surface, beside, np.ones_like(beside), 0.02).any()
    assert sample(surface, np.array([[-0.999, 3.999]]), np.ones((1, 2)), 0.02).tolist() == [[2.0, 2.0]]


def test_d10_disparities_are_measured_from_the_subject() -> None:
    """A wide pair's subject lies in the middle of both pictures: what is left is a residual, whatever the offset of
    the principal points."""
    pair = rectify(WIDE[2], 0, 1, ORIGIN)
    distance = -(pair.rotation @ pair.centres[0])[2]
    assert abs(float(pair.disparity(np.float64(distance)))) < 1e-9
    assert abs(pair.offset) > 512


@pytest.mark.parametrize("size", [(640, 480), (3, 50), (1, 1)])
def test_d11_d15_pixels_come_back_to_themselves_in_pictures_of_any_shape(size: tuple[int, int]) -> None:
    assert round_trip(size, 0.0) < 1e-9
    assert round_trip(size, 0.5) == pytest.approx(np.sqrt(0.5))


def test_d12_one_threshold() -> None:
    found = run(named("D12"))
    assert found.ours == 0
    assert found.naive > 50


@pytest.mark.parametrize("texture", [0, 255])
def test_d13_without_texture_depth_stays_within_its_bounds(texture: int) -> None:
    """Plain pictures say nothing: whatever is matched lies in the searched range, and nothing beside the mask."""
    rig, colors, depths = sphere_scene()
    plain = [np.full_like(c, texture) for c in colors]
    bounds = bounds_around(depths[0])
    found = match(rectify(rig, 0, 1, ORIGIN), *plain, depths[0] > 0, bounds)
    assert not found[depths[0] == 0].any()
    # The maps are sampled between pixels; on the sphere's rim a pixel is a tenth of a metre.
    inner = (found > 0) & (cv2.erode((depths[0] > 0).astype(np.uint8), np.ones((9, 9))) > 0)
    assert ((found >= bounds.near - 0.02) & (found <= bounds.far + 0.02))[inner].all()


def test_d14_what_the_other_view_cannot_see_loses_its_match_more_often_than_not() -> None:
    assert hidden_scene()[3].sum() > 500
    assert wrong_where_hidden(True) < 0.5 * wrong_where_hidden(False)
