"""Views with few partners: what their first search follows, and what fills the gaps it leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posegaussian.stages.depth.algorithms.few_partners import (
    OWN,
    Limbs,
    completed,
    searched,
    unmatched,
    with_few_partners,
)
from posegaussian.stages.depth.algorithms.pose_prior import FOOT, MARGIN, first_met, flesh_of, limbs_of
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, hulls, surfaces
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.depth.stage import STAGE
from posegaussian.stages.geometry.pairs import MAX_ANGLE
from posegaussian.stages.geometry.projection import rays, unproject
from posegaussian.stages.matching.fuse import complete
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.cameras import points_from_integer_centres
from posegaussian.storage.model.joint_sets import COCO17
from tests.support.memory_inputs import run_stage

PAIR = (0, 1)
"""Neighbours of a ring of eight, 45 degrees apart."""
SQUARE = (0, 2, 4, 6)
"""Every other camera of it, 90 degrees apart."""


@pytest.fixture(scope="module")
def kick() -> PersonCapture:
    return capture_person(views=8, size=160, frames=1, held_out=0, motion="kick")


def frame_of(c: PersonCapture, views: tuple[int, ...], joints: bool = True) -> Frame:
    known = c.joints3d[0] if joints else np.zeros((17, 4))
    masks = {v: c.mask[0, v] for v in views}
    return Frame({v: c.color[0, v] for v in views}, masks, limbs_of(known), flesh_of(known))


def geometry_of(c: PersonCapture, views: tuple[int, ...], max_angle: float = MAX_ANGLE) -> Geometry:
    return Geometry.of(c.rig, views, DepthParams(method="sweep", max_angle=max_angle))


@pytest.mark.parametrize(
    ("views", "few"),
    [((0, 1), {0, 1}), ((0, 1, 2), {0, 2}), (tuple(range(8)), set()), (SQUARE, set(SQUARE)), ((0, 4), set())],
)
def test_views_are_meant_that_are_compared_but_not_with_two_others_near_by(
    kick: PersonCapture, views: tuple[int, ...], few: set[int]
) -> None:
    """Of three neighbours the outer two have a second partner 90 degrees away; two that face each other none."""
    geometry, frame = geometry_of(kick, views), frame_of(kick, views)
    assert set(with_few_partners(geometry, frame, hulls(geometry, frame))) == few


def test_a_view_without_a_partner_lies_on_the_limbs_behind_its_hulls_surface(kick: PersonCapture) -> None:
    """Where joints are known; a hull of four silhouettes lies in front of what it holds."""
    geometry, frame = geometry_of(kick, SQUARE, max_angle=40.0), frame_of(kick, SQUARE)
    found = hulls(geometry, frame)
    assert with_few_partners(geometry, frame, found) == {}
    surface, on = surfaces(geometry, found), unmatched(geometry, found, frame.flesh)
    off: dict[str, list[np.ndarray]] = {"surface": [], "limbs": []}
    for v, (near, far) in found.items():
        inside, seen = near > 0, (kick.depth[0, v] > 0) & (near > 0)
        assert (on[v] >= surface[v])[inside].all()
        assert (on[v] <= np.maximum(far, surface[v]))[inside].all()
        np.testing.assert_array_equal(on[v] > 0, surface[v] > 0)
        off["surface"].append(np.abs(surface[v] - kick.depth[0, v])[seen])
        off["limbs"].append(np.abs(on[v] - kick.depth[0, v])[seen])
    assert np.concatenate(off["limbs"]).mean() < 0.6 * np.concatenate(off["surface"]).mean()
    for v, depth in unmatched(geometry, found, np.zeros((0, 7))).items():
        np.testing.assert_array_equal(depth, surface[v])
    served = geometry_of(kick, SQUARE)
    for v, depth in unmatched(served, found, frame.flesh).items():
        np.testing.assert_array_equal(depth, surface[v])


def test_windows_follow_a_plane_through_the_subject_that_both_cameras_see_at_the_same_angle(
    kick: PersonCapture,
) -> None:
    """The hull's own near end, seen by the partner, is a line: its windows there hold nothing to compare."""
    geometry, frame = geometry_of(kick, PAIR), frame_of(kick, PAIR)
    found = hulls(geometry, frame)
    for v in PAIR:
        bounds, _ = searched(geometry, v, found[v], 0.0, with_few_partners(geometry, frame, found))
        inside = bounds.guide > 0
        np.testing.assert_array_equal(inside, found[v][0] > 0)
        points = unproject(bounds.guide, kick.rig.intrinsics[v], kick.rig.world_to_camera[v])[inside]
        normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
        # float32 depth of some metres: micrometres
        np.testing.assert_allclose((points - geometry.centre) @ normal, 0, atol=1e-5)
        towards = kick.rig.centres[list(PAIR)] - geometry.centre
        angles = np.abs(towards @ normal) / np.linalg.norm(towards, axis=1)
        np.testing.assert_allclose(angles[0], angles[1], atol=1e-5)


def test_windows_follow_a_hull_that_many_views_carve(kick: PersonCapture) -> None:
    """Four views of a ring, the first two neighbours, the others across: each has a single partner."""
    views = (0, 1, 4, 5)
    geometry, frame = geometry_of(kick, views), frame_of(kick, views)
    found = hulls(geometry, frame)
    single = with_few_partners(geometry, frame, found)
    assert set(single) == set(views)
    for v in views:
        bounds, _ = searched(geometry, v, found[v], 0.0, single)
        np.testing.assert_array_equal(bounds.guide, found[v][0])


def test_the_search_ends_behind_the_front_of_bones_and_nowhere_outside_the_hull(kick: PersonCapture) -> None:
    geometry, frame = geometry_of(kick, PAIR), frame_of(kick, PAIR)
    found = hulls(geometry, frame)
    for v, (near, far) in found.items():
        single = with_few_partners(geometry, frame, found)
        limbs = single[v]
        assert limbs is not None
        bounds, limits = searched(geometry, v, found[v], 0.0, single)
        assert (bounds.far <= far).all()
        assert (bounds.far >= near)[near > 0].all()
        np.testing.assert_array_equal(bounds.far, limits[1])
        met = (limbs.core > 0) & (limbs.core + OWN >= near) & (limbs.core + OWN <= far)
        assert met.mean() > 0.3 * (near > 0).mean()
        np.testing.assert_allclose(bounds.far[met], limbs.core[met] + OWN, rtol=1e-6)
        seen = (kick.depth[0, v] > 0) & (near > 0)
        shut_out = (kick.depth[0, v] > bounds.far + 1e-3) & seen
        assert shut_out.sum() <= 0.01 * seen.sum(), "what the view sees lies within what is searched"
    free = with_few_partners(geometry, frame_of(kick, PAIR, joints=False), found)
    assert free == {0: None, 1: None}


def test_a_gap_continues_what_was_measured_on_its_own_limb() -> None:
    """Two limbs side by side, measured 3 cm behind the one's capsule and 5 cm before the other's."""
    which = np.repeat([[0] * 8 + [1] * 8], 4, axis=0)
    capsule = np.where(which == 0, 2.0, 3.0).astype(np.float32)
    true = np.where(which == 0, 2.03, 2.95).astype(np.float32)
    hull = (np.full_like(true, 1.5), np.full_like(true, 3.5))
    matched = true.copy()
    matched[:, 4:14] = 0
    confidence = np.where(matched > 0, 0.9, 0).astype(np.float32)
    limbs = Limbs(capsule, which, capsule)
    depth, sure = completed((matched, confidence), hull, hull[0], limbs)
    np.testing.assert_allclose(depth, true, atol=1e-6)
    without, same = complete(matched, confidence, *hull, hull[0])
    np.testing.assert_array_equal(sure, same)
    assert np.abs(without - true).max() > 0.5, "by the farther of its surroundings the nearer limb would be the other"


def test_what_meets_no_limb_or_lies_far_off_it_is_filled_as_everywhere() -> None:
    rng = np.random.default_rng(0)
    hull = (np.full((6, 9), 1.5, np.float32), np.full((6, 9), 2.5, np.float32))
    matched = rng.uniform(1.6, 2.4, (6, 9)).astype(np.float32) * (rng.random((6, 9)) < 0.5)
    confidence = (matched > 0) * np.float32(0.8)
    nothing = Limbs(np.zeros((6, 9), np.float32), np.full((6, 9), -1), np.zeros((6, 9), np.float32))
    for limbs in (None, nothing):
        for got, want in zip(
            completed((matched, confidence), hull, hull[0], limbs),
            complete(matched, confidence, *hull, hull[0]),
            strict=True,
        ):
            np.testing.assert_array_equal(got, want)
    # A limb in front of the hull: its gaps stay within the hull, and what was matched stays as it is.
    close = Limbs(np.full((6, 9), 1.0, np.float32), np.zeros((6, 9), int), np.zeros((6, 9), np.float32))
    depth, _ = completed((matched, confidence), hull, hull[0], close)
    np.testing.assert_array_equal(depth[matched == 0], 1.5)
    np.testing.assert_array_equal(depth[matched > 0], matched[matched > 0])


def test_flesh_is_within_the_limbs_and_has_no_foot_and_no_reach(kick: PersonCapture) -> None:
    joints = kick.joints3d[0].copy()
    limbs, flesh = limbs_of(joints), flesh_of(joints)
    held = [np.abs(limbs - (*f[:6], f[6] + MARGIN)).max(axis=1).min() for f in flesh]
    np.testing.assert_allclose(held, 0, atol=1e-9)
    assert len(limbs) == len(flesh) + 2, "two feet"
    np.testing.assert_allclose(flesh_of(joints, feet=True), limbs - [0, 0, 0, 0, 0, 0, MARGIN], atol=1e-9)
    balls = flesh[(flesh[:, :3] == flesh[:, 3:6]).all(axis=1)]
    assert len(balls) == 1, "the head"
    assert balls[0, 6] < FOOT
    joints[COCO17.names.index("RWrist"), 3] = 0
    assert len(flesh_of(joints)) == len(flesh) - 2, "neither forearm nor hand, nor where they may be"
    assert len(flesh_of(joints, feet=True)) == len(flesh)
    assert not len(flesh_of(np.zeros((17, 4))))


def test_the_first_capsule_on_a_ray_is_met(kick: PersonCapture) -> None:
    """Against spheres, whose entry has a formula."""
    rig, (width, height) = kick.rig, (int(n) for n in kick.rig.size[0])
    centre = kick.joints3d[0, 5:13, :3].mean(axis=0)
    balls = np.array([(*c, *c, r) for c, r in ((centre, 0.3), (centre + np.array([0.2, 0.1, 0]), 0.2))])
    depth, which = first_met(rig, 0, np.ones((height, width), bool), balls)
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    origin, d = rays(
        points_from_integer_centres(np.stack([columns, rows], axis=-1)), rig.intrinsics[0], rig.world_to_camera[0]
    )
    entries = []
    for ball in balls:
        b, a, c = d @ (origin - ball[:3]), (d**2).sum(-1), ((origin - ball[:3]) ** 2).sum() - ball[6] ** 2
        inside = b**2 - a * c
        entries.append(np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf))
    first = np.min(entries, axis=0)
    np.testing.assert_allclose(depth, np.where(np.isfinite(first), first, 0), rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(which >= 0, np.isfinite(first))
    assert set(np.unique(which)) == {-1, 0, 1}


def wrong(c: PersonCapture, views: tuple[int, ...], params: DepthParams, joints: np.ndarray) -> float:
    """Share of the surface that is off by more than 5 cm."""
    arrays = {"frames/color": c.color, "frames/mask": c.mask, "pose/joints3d": joints.astype(np.float32)}
    found = run_stage(
        STAGE,
        params,
        arrays,
        c.rig,
        replace(c.views, sources=views),
        1,
        None,
        effects=frozenset({"left_right_check", "limb_bounds"}),
    )["depth/depth"][0, list(views)]
    surface = (c.mask[0, list(views)] > 127) & (c.depth[0, list(views)] > 0)
    return float((np.abs(found - c.depth[0, list(views)]) > 0.05)[surface].mean())


@pytest.mark.parametrize("method", ["sweep", "sgbm"])
def test_joints_put_limbs_where_they_are_that_one_camera_of_two_sees(kick: PersonCapture, method: str) -> None:
    params, unknown = DepthParams(method=method), kick.joints3d * [1, 1, 1, 0]
    assert wrong(kick, PAIR, params, kick.joints3d) < 0.6 * wrong(kick, PAIR, params, unknown)


def test_four_cameras_around_are_compared(kick: PersonCapture) -> None:
    """Each with the two 90 degrees away. Where they are not, and joints are unknown, a hull of four silhouettes is all
    there is; joints alone would do for this person, who is made of limbs."""
    unknown = kick.joints3d * [1, 1, 1, 0]
    compared, apart = (wrong(kick, SQUARE, DepthParams(method="sweep", max_angle=a), unknown) for a in (105, 66))
    assert compared < 0.8 * apart
