"""What is known of the subject before its pixels are looked at: segmentations in place, and views that speak for or
against each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posegaussian.stages.frames.bodies.body import pixels_per_metre
from posegaussian.stages.frames.bodies.own_joints import pixels_per_metre_at
from posegaussian.stages.frames.segmentation_prior import warped_hint
from posegaussian.stages.geometry.points import project
from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.imaging.camera_mapping import captured_positions
from posegaussian.stages.imaging.regions import crop, to_own
from posegaussian.stages.silhouettes.support import Fields, ray_support
from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from posegaussian.storage.model.cameras import Rig, to_integer_centres
from posegaussian.storage.model.joint_sets import COCO17
from tests.support.person_estimates import hints_of, segmented
from tests.support.walking_skeleton import SKELETON


@pytest.mark.parametrize("region", [[60.0, 40.0, 90.0, 0.0], [50.0, 45.0, 70.0, 0.6], [64.0, 48.0, 30.0, -2.1]])
def test_a_hint_lies_where_the_estimator_looked(region: list[float]) -> None:
    # A ramp over the region is what bilinear sampling reproduces exactly;
    # one step of uint8 and half of rounding remain.
    i, j = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(256) + 0.5) / 256, indexing="ij")
    person = np.rint(255 * (0.2 + 0.5 * j + 0.3 * i)).astype(np.uint8)
    captured = pixel_centres((128, 96))
    found = warped_hint(person, np.array(region), captured)
    own = to_own(captured.reshape(-1, 2), np.array(region)).reshape(96, 128, 2)
    inside = ((own > 0.01) & (own < 0.99)).all(axis=-1)
    assert inside.sum() > 500
    assert np.abs(found - (0.2 + 0.5 * own[..., 0] + 0.3 * own[..., 1]))[inside].max() < 1.5 / 255
    assert (found[((own < -0.01) | (own > 1.01)).any(axis=-1)] < 0).all()


def test_a_coarse_grid_averages_the_hint() -> None:
    stripes = np.tile(np.array([0, 255], np.uint8), (256, 128))
    coarse = warped_hint(stripes, np.array([64.0, 64.0, 128.0, 0.0]), pixel_centres((16, 16)) * 8)
    assert np.abs(coarse - 0.5).max() < 0.01


@pytest.mark.parametrize("off_centre", [-3.0, 3.0])
def test_a_lens_whose_model_ends_before_a_corner_blurs_no_hint(off_centre: float) -> None:
    """One of the top corners has a picture, the other has none; within, the hint is as fine as it is without."""
    person = capture_person(4, 160, 1, 0)
    person.rig.intrinsics[:, 0, 2] += off_centre
    k = person.rig.intrinsics[0]
    lens = np.zeros_like(person.rig.distortion)
    lens[:, 0] = -(k[0, 0] ** 2) / 3 / (80**2 + k[1, 2] ** 2)  # as far as a corner of a picture in the middle
    cameras = replace(person.rig, distortion=lens)
    arrays = segmented(person)
    hint = hints_of(person, arrays, 0, source_rig=cameras).of_view(0, 0)
    captured = captured_positions(pixel_centres((160, 160)), k, k, lens[0], np.array([1.0, 0.0, 0.0]))
    assert np.isnan(captured[0, [0, -1], 0]).sum() == 1
    imaged = np.isfinite(captured).all(axis=-1)
    assert hint is not None
    np.testing.assert_array_equal(hint >= 0, imaged & (captured >= 0).all(axis=-1) & (captured <= 160).all(axis=-1))
    row, column = (np.where(imaged, captured[..., i], 0.0).clip(0, 159).astype(int) for i in (1, 0))
    there = imaged & (person.mask[0, 0][row, column] > 127)
    assert there.sum() > 1000
    assert ((hint > 0.5) & there).sum() > 0.9 * ((hint > 0.5) | there).sum()


def _one_sided(value: float, size: int = 32) -> tuple[Rig, Fields]:
    """Three cameras of a ring; the last two hold `value` possible everywhere, and saw as much."""
    rig = capture_person(3, size, 1, 0).rig
    fields = Fields(
        *(np.full((2, size, size), value, np.float32) for _ in range(2)),
        to_integer_centres(rig.intrinsics[1:]) @ rig.world_to_camera[1:, :3],
    )
    return rig, fields


def test_views_that_look_elsewhere_carve_nothing_and_confirm_nothing() -> None:
    _, fields = _one_sided(0.0)
    away = np.array([[0.0, 0.0, 1.0]])
    high = np.array([0.0, 0.0, 100.0])
    for joints, allowed in (
        (np.zeros((0, 3)), 1),
        (np.array([[0.3, 0.0, 102.0]]), 1),
        (np.array([[0.6, 0.0, 102.0]]), 0),
    ):
        possible, confirmed = ray_support(fields, high, away, np.linspace(1, 3, 9), joints)
        assert possible[0] == allowed, "what nobody sees is possible near a joint"
        assert confirmed[0] == 0


def test_far_from_all_joints_nothing_is_confirmed_whoever_counts_it_to_the_subject() -> None:
    rig, fields = _one_sided(1.0)
    middle = np.array([0.0, 0.0, 0.93])
    to_middle = (middle - rig.centres[0])[None] / 2.0
    for beside, confirmed in ((0.4, 1), (0.5, 0)):
        joints = middle[None] + np.array([[0.0, 0.0, beside]])
        found = ray_support(fields, rig.centres[0], to_middle, np.array([2.0]), joints)
        assert found[1][0] == confirmed
        assert found[0][0] == 1, "what two views allow is possible all the same"


def test_support_is_the_least_that_any_view_says_and_the_most_along_the_ray() -> None:
    rig, fields = _one_sided(0.4)
    to_middle = (np.array([[0.0, 0.0, 0.93]]) - rig.centres[0]) / 2.0
    fields.possible[1] = 0.7
    possible, confirmed = ray_support(fields, rig.centres[0], to_middle, np.array([2.0]), np.zeros((0, 3)))
    assert possible[0] == np.float32(0.4)
    assert confirmed[0] == np.float32(0.4)
    fields.seen[0] = -1.0  # that view does not picture it: one witness of two is too few
    assert ray_support(fields, rig.centres[0], to_middle, np.array([2.0]), np.zeros((0, 3)))[1][0] == 0


def test_the_other_views_allow_all_of_the_subject_and_confirm_its_middle() -> None:
    person = capture_person(6, 160, 1, 0)
    arrays = segmented(person)
    for view in (0, 3):
        support = hints_of(person, arrays, view).support(view, 0)
        assert support is not None
        possible, confirmed = support
        there = person.mask[0, view] > 127
        assert (possible[there] > 0.5).mean() > 0.999
        assert (possible > 0.5).mean() < 3.5 * there.mean()
        assert (confirmed[there] > 0.5).mean() > 0.8


def test_a_view_that_found_nobody_says_nothing() -> None:
    person = capture_person(4, 64, 1, 0)
    arrays = segmented(person)
    arrays["pose/chosen"][:, 2] = -1
    lacking = hints_of(person, arrays, 0).support(0, 0)
    arrays["detection/person"][:, 2] = 0
    arrays["pose/chosen"][:, 2] = 0
    empty = hints_of(person, arrays, 0).support(0, 0)
    assert lacking is not None
    assert empty is not None
    for a, b in zip(lacking, empty, strict=True):
        np.testing.assert_array_equal(a, b)
    arrays["pose/chosen"][:] = -1
    assert hints_of(person, arrays, 0).support(0, 0) is None


def test_a_view_carves_nothing_where_its_estimator_did_not_look() -> None:
    """One view looked at the head alone: what lies beyond that square is as possible, and as sure, as to the others."""
    person = capture_person(6, 160, 1, 0)
    arrays, lacking = segmented(person), segmented(person)
    head = np.array([*person.joints2d[0, 2, 0, :2], 40.0, 0.0])
    arrays["detection/region"][0, 2, 0] = head
    arrays["detection/person"][0, 2, 0] = crop(person.mask[0, 2][..., None].repeat(3, 2), head, (256, 256))[..., 0]
    lacking["pose/chosen"][:, 2] = -1
    looked, without = (hints_of(person, a, 0).support(0, 0) for a in (arrays, lacking))
    assert looked is not None
    assert without is not None
    there = person.mask[0, 0] > 127
    assert (looked[0][there] > 0.5).mean() > 0.999
    below = np.arange(160) > person.joints2d[0, 0, COCO17.names.index("LHip"), 1]
    for with_it, without_it in zip(looked, without, strict=True):
        np.testing.assert_array_equal(with_it[below], without_it[below])


def test_the_scale_of_a_picture_is_known_from_where_the_subject_stands() -> None:
    person = capture_person(4, 160, 1, 0, motion="kick")
    arrays = segmented(person)
    hints = hints_of(person, arrays, 1)
    depth = float((person.rig.world_to_camera[1] @ np.append(person.joints3d[0, :, :3].mean(axis=0), 1.0))[2])
    focal = float(person.rig.intrinsics[1, [0, 1], [0, 1]].mean())
    assert hints.known(1, 0).scale == pytest.approx(focal / depth, rel=0.15)
    arrays["pose/joints3d"][..., 3] = 0
    assert hints_of(person, arrays, 1).known(1, 0).scale == 0


def test_how_large_a_metre_is_does_not_hang_on_where_limbs_point() -> None:
    """Of whoever lies along the optical axis, of a child, and of somebody upright at the same depth."""
    rig, upright = capture_person(3, 64, 1, 0).rig, np.ones((17, 4))
    upright[:, :3] = SKELETON - SKELETON.mean(axis=0)
    forward, right = rig.rotations[0, 2], rig.rotations[0, 0]
    lying = upright.copy()
    lying[:, :3] = upright[:, :3] @ np.stack([np.cross(forward, right), right, forward])
    expected = float(rig.intrinsics[0, [0, 1], [0, 1]].mean()) / 3.0
    for posed, size in ((upright, 1.0), (lying, 1.0), (upright, 0.6)):
        joints = posed * [size, size, size, 1.0]
        joints[:, :3] += rig.centres[0] + 3.0 * forward
        found = pixels_per_metre_at(rig, 0, joints, "coco17")
        assert found == pytest.approx(size * expected, rel=0.06)
        assert pixels_per_metre_at(rig, 0, joints * [1, 1, 1, 0], "coco17") == 0
        seen = np.concatenate([project(rig.subset([0]), joints[:, :3])[0][:, 0], np.ones((17, 1))], axis=1)
        assert (pixels_per_metre(seen, "coco17") < 0.8 * found) == (posed is lying)
