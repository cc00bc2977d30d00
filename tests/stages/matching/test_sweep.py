from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from benchmarks.depth.plain_cost_volume import cost_volume as plain
from posegaussian.stages.depth.algorithms import sweeping
from posegaussian.stages.depth.algorithms.occluding_contour import turn_away
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, hull_only
from posegaussian.stages.depth.algorithms.sweeping import doubted, sweep_hull
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.matching.aggregate import aggregate, minimum
from posegaussian.stages.matching.bounds import Bounds
from posegaussian.stages.matching.cost import FORBIDDEN, WORST, cost_volume
from posegaussian.stages.matching.fuse import HULL, MATCHED
from posegaussian.stages.matching.sweep import MOST, Neighbours, labels, nearest, sweep
from posegaussian.stages.simulator.subjects.capsule_person import capture_person, look_at, render, samples_per_side
from posegaussian.stages.simulator.subjects.motion import pose
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of, ring, sphere_depth, sphere_mask

Arguments = tuple[
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    tuple[int, int],
    int,
    float,
    float,
]


def arguments(neighbours: int, channels: int = 1, share: float = 0.5) -> Arguments:
    """Of `cost_volume`: a corner of a rolled view of noise with a few neighbours, one of them seeing half of it."""
    random = np.random.default_rng(neighbours)
    rig = rig_of(
        [camera(on_ring(25 * i), np.array([0.5 * (i == 2), 0, 0]), roll=20 * i) for i in range(neighbours + 1)],
        (40, 32),
        45.0,
    )
    beside = Neighbours.of(rig, 0, tuple(range(1, neighbours + 1)), np.zeros(3))
    first, others = (
        random.normal(0, 30, (channels, 20, 24)).astype(np.float32),
        random.normal(0, 30, (neighbours, channels, 32, 40)).astype(np.float32),
    )
    mask = random.random((20, 24)) > 0.2
    mask[:3] = False
    guide = (0.5 + 0.02 * random.random((20, 24))).astype(np.float32)
    offsets = np.linspace(-0.06, 0.06, 5).astype(np.float32)
    sizes = np.tile(np.float32([40, 32]), (neighbours, 1))
    return (
        first,
        mask,
        guide,
        guide - np.float32(0.04),
        guide + np.float32(0.2),
        offsets,
        others,
        sizes,
        beside.transfers,
        (9, 5),
        2,
        4.0,
        share,
    )


@pytest.mark.parametrize(("neighbours", "channels", "share"), [(1, 1, 1.0), (2, 3, 0.5), (3, 1, 0.5), (4, 1, 1.0)])
def test_the_fused_kernel_agrees_with_the_plain_one(neighbours: int, channels: int, share: float) -> None:
    given = arguments(neighbours, channels, share)
    found = cost_volume(*given).astype(int)
    expected = (
        plain(
            *(
                (
                    torch.from_numpy(np.asarray(a)).double()
                    if isinstance(a, np.ndarray) and a.dtype != bool
                    else torch.from_numpy(a)
                    if isinstance(a, np.ndarray)
                    else a
                )
                for a in given
            )
        )
        .numpy()
        .astype(int)
    )
    np.testing.assert_array_equal(found == FORBIDDEN, expected == FORBIDDEN)
    # float32 against float64: a rounding may fall to the other side.
    assert np.abs(found - expected).max() <= 1
    assert (found != expected).mean() < 0.01
    assert len(np.unique(found)) > 20


def test_a_picture_costs_nothing_at_its_own_surface_and_gains_cost_little() -> None:
    first, mask, guide, low, high, offsets, _, sizes, _, corner, *rest = arguments(1)
    still = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1)[None]
    other = np.zeros((1, 1, 32, 40), np.float32)
    other[0, 0, 5:25, 9:33] = first[0]
    inner = np.zeros_like(mask)
    inner[:-1, :-1] = mask[:-1, :-1]
    same = cost_volume(first, inner, guide, low, high, offsets, other, sizes, still, corner, *rest)
    # Not 0 exactly: the floor of the noise, 4 of a variance of 900, and more where a window holds few pixels.
    assert same[inner][:, 1:].max() <= 0.02 * WORST
    brighter = cost_volume(
        first, inner, guide, low, high, offsets, other * np.float32(1.1) + 5, sizes, still, corner, *rest
    )
    assert brighter[inner][:, 1:].max() < 0.15 * WORST


def test_aggregation_of_one_pixel_wide_evidence() -> None:
    # A line whose middle does not know its label takes it from both ends; a mask in between cuts it off.
    volume = np.full((1, 9, 4), 100, np.uint8)
    volume[0, [0, 1, 7, 8], 2] = 0
    mask = np.ones((1, 9), bool)
    level = np.zeros((1, 9), np.float32)
    np.testing.assert_array_equal(
        minimum(aggregate(volume, mask, level, 10, 50), volume, mask), np.full((1, 9), 2, np.float32)
    )
    level[0, 3:6] = 5
    alone = aggregate(volume, mask, level, 10, 50)
    assert (alone[0, 3:6] == alone[0, 3:6, :1]).all()
    volume[0, 4] = FORBIDDEN
    assert minimum(aggregate(volume, mask, level, 10, 50), volume, mask)[0, 4] == -1


def test_the_minimum_is_that_of_the_parabola() -> None:
    total = ((np.arange(6) - 2.3) ** 2 * 100).astype(np.uint16)[None, None]
    assert minimum(total, np.zeros((1, 1, 6), np.uint8), np.ones((1, 1), bool))[0, 0] == pytest.approx(2.3, abs=0.01)


def test_labels_hold_the_range_and_zero_and_are_bounded() -> None:
    found = labels(np.linspace(-0.3, -0.1, 500), np.linspace(0.1, 0.5, 500), 0.01)
    assert np.abs(found).min() < 1e-6
    assert found[0] < -0.29
    assert found[-1] > 0.49
    assert len(labels(np.full(9, -1.0), np.full(9, 1.0), 1e-4)) <= MOST


def test_motion_is_that_of_a_moved_point_and_neighbours_are_the_nearest() -> None:
    rig = ring(8)
    beside = Neighbours.of(rig, 0, nearest(rig, 0, tuple(range(8)), 2, 66.0, np.zeros(3)), np.zeros(3))
    assert beside.views == (1, 7)
    # At 45 degrees and 2 m: baseline across the line of sight of the neighbour over 1/depth.
    here = beside.transfers @ np.array([31.5, 31.5, 1.0, 0.5])
    there = beside.transfers @ np.array([31.5, 31.5, 1.0, 0.5 + 1e-6])
    moved = np.linalg.norm(there[:, :2] / there[:, 2:] - here[:, :2] / here[:, 2:], axis=1) / 1e-6
    np.testing.assert_allclose(beside.motion, moved, rtol=1e-3)
    assert nearest(rig, 0, tuple(range(8)), 4, 30.0, np.zeros(3)) == ()


def rolled_person(size: tuple[int, int]) -> tuple[Rig, np.ndarray, np.ndarray, np.ndarray]:
    """Five views of the person over 100 degrees, each rolled differently, not square, off-centre:
    rig, colors, masks, depths."""
    angles, k = (
        np.radians([0, 25, 50, 75, 100]),
        np.array([[195.0, 0, 0.45 * size[0]], [0, 190.0, 0.52 * size[1]], [0, 0, 1]]),
    )
    poses = []
    for i, a in enumerate(angles):
        upright = look_at(np.array([2.4 * np.cos(a), 2.4 * np.sin(a), 1.0 + 0.2 * i]), np.array([0.0, 0, 0.93]))
        turn = np.eye(4)
        t = np.radians((-80, 15, 90, 40, 180)[i])
        turn[:2, :2] = [[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]]
        poses.append(turn @ upright)
    rig = Rig(
        tuple(f"c{i}" for i in range(5)),
        np.tile(k, (5, 1, 1)),
        np.zeros((5, 8)),
        np.stack(poses),
        np.tile(np.array(size), (5, 1)),
    )
    found = [render(pose("stand", 0.0), k, p, size, samples_per_side(max(size))) for p in poses]
    return rig, *(np.stack(a) for a in zip(*found, strict=True))


def test_rolled_cameras_and_pictures_that_are_not_square() -> None:
    rig, colors, masks, depths = rolled_person((270, 210))
    frame = Frame(dict(enumerate(colors)), dict(enumerate(masks)))
    params = DepthParams(method="sweep")
    maps = sweep_hull(Geometry.of(rig, tuple(range(5)), params), frame, params)
    hull = Geometry.of(rig, tuple(range(5)), DepthParams(method="hull"))
    bounds = hull_only(hull, frame)
    surface = (masks[2] > 127) & (depths[2] > 0) & (bounds[2][0] > 0)
    error, coarse = (np.abs(m[2][0] - depths[2])[surface] for m in (maps, bounds))
    # A pixel is 1.2 cm at this size.
    assert np.median(error) < 0.012
    assert error.mean() < 0.7 * coarse.mean()
    assert (maps[2][1][surface] >= MATCHED).mean() > 0.8


def test_padding_is_never_looked_at() -> None:
    c = capture_person(views=8, size=72, frames=1, held_out=0)
    params = DepthParams(method="sweep")
    geometry = Geometry.of(c.rig, tuple(range(8)), params)
    plain_maps = sweep_hull(geometry, Frame(dict(enumerate(c.color[0])), dict(enumerate(c.mask[0]))), params)
    color = np.pad(c.color[0], ((0, 0), (0, 8), (0, 16), (0, 0)), constant_values=200)
    mask = np.pad(c.mask[0], ((0, 0), (0, 8), (0, 16)))
    padded = sweep_hull(geometry, Frame(dict(enumerate(color)), dict(enumerate(mask))), params)
    for v in range(8):
        np.testing.assert_array_equal(padded[v][0][:72, :72], plain_maps[v][0])
        assert not padded[v][0][72:].any()


def test_a_view_without_a_rectified_pair_is_swept_in_every_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    c = capture_person(views=8, size=72, frames=1, held_out=0)
    params, frame = DepthParams(method="sweep"), Frame(dict(enumerate(c.color[0])), dict(enumerate(c.mask[0])))
    paired, unpaired, some = (Geometry.of(c.rig, tuple(range(8)), params) for _ in range(3))
    unpaired.__dict__["pairs"] = {}
    some.__dict__["pairs"] = {order: pair for order, pair in paired.pairs.items() if 0 not in order}
    rows, without, mixed = (sweep_hull(g, frame, params) for g in (paired, unpaired, some))
    monkeypatch.setattr(sweeping, "PASSES", tuple(replace(p, in_rows=False) for p in sweeping.PASSES))
    swept = sweep_hull(paired, frame, params)
    for v in range(8):
        np.testing.assert_array_equal(without[v][0], swept[v][0])
        assert (rows[v][0] != swept[v][0]).any(), "pairs are matched along their rows"
        np.testing.assert_array_equal(mixed[v][0] > 0, rows[v][0] > 0)


def test_nothing_wanted_and_no_neighbour_give_nothing() -> None:
    rig = ring(3)
    zero = np.zeros((64, 64), np.float32)
    pictures = {v: np.zeros((1, 64, 64), np.float32) for v in range(3)}
    beside = Neighbours.of(rig, 0, (1, 2), np.zeros(3))
    assert not sweep(pictures, rig.size, 0, beside, Bounds(zero, zero, zero), 1.0, 2, 0.5).any()
    one = np.ones_like(zero)
    assert not sweep(
        pictures, rig.size, 0, Neighbours.of(rig, 0, (), np.zeros(3)), Bounds(one, one, one), 1.0, 2, 0.5
    ).any()


def test_the_rim_of_a_sphere_is_continued() -> None:
    rig, centre, radius = ring(1, (128, 128), 130.0), np.array([0.1, -0.05, 0.1]), 0.3
    truth, inside = sphere_depth(rig, 0, centre, radius), sphere_mask(rig, 0, centre, radius) > 127
    flat = np.where(inside, truth, 0).astype(np.float32)
    near = inside & (truth > 0)
    edge = near & (cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5) <= 1.0)
    flat[edge] -= 0.08
    open_bounds = np.full_like(flat, 1e-3), np.full_like(flat, 9.0)
    sure = np.where(inside, 0.9, 0).astype(np.float32)
    turned, _ = turn_away(rig, 0, flat, sure, *open_bounds, inside)
    # The depth of the last pixel falls by a pixel of 1.5 cm times the square root of twice the radius of 20 px.
    assert np.abs(turned - truth)[edge].mean() < 0.03
    assert np.abs(turned - truth)[edge].mean() < 0.5 * np.abs(flat - truth)[edge].mean()
    np.testing.assert_array_equal(turned[~edge], flat[~edge])
    # The hull's own rim is left alone, and the hull's bounds hold.
    unsure, _ = turn_away(rig, 0, flat, np.minimum(sure, np.float32(HULL)), *open_bounds, inside)
    np.testing.assert_array_equal(unsure, flat)
    with np.errstate(all="raise"):
        whole, _ = turn_away(rig, 0, flat, sure, *open_bounds, np.ones_like(inside))
    np.testing.assert_array_equal(whole, flat)
    clipped, _ = turn_away(rig, 0, flat, sure, open_bounds[0], flat, inside)
    np.testing.assert_array_equal(clipped, flat)


def test_an_unmatched_frame_is_the_hull() -> None:
    c = replace(capture_person(views=3, size=48, frames=1, held_out=0))
    params = DepthParams(method="sweep")
    maps = sweep_hull(
        Geometry.of(c.rig, tuple(range(3)), params),
        Frame(dict(enumerate(c.color[0])), dict(enumerate(c.mask[0]))),
        params,
    )
    assert max(k.max() for _, k in maps.values()) <= np.float32(HULL)


def test_matches_beside_a_jump_are_doubted_and_stay_matches() -> None:
    depth = np.full((9, 12), 2.0, np.float32)
    depth[:, 6:] = 1.0
    depth[0, 0] = 0
    trust = np.where(depth > 0, 0.9, 0).astype(np.float32)
    found = doubted(depth, trust, 20.0)
    np.testing.assert_array_equal(found[1:, [0, 3, 8, 11]], trust[1:, [0, 3, 8, 11]])
    # 10 px of disparity between the two.
    np.testing.assert_allclose(found[:, 4:8], MATCHED + 0.4 / 1.9, rtol=1e-6)
    assert found[0, 0] == 0
    assert not np.isnan(doubted(np.zeros_like(depth), np.zeros_like(depth), 20.0)).any()
