"""A calibration that contradicts itself or its pictures is told by its numbers alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posegaussian.stages.imaging.camera_mapping import left_out
from posegaussian.stages.inspection.cameras import confirmed, of_aim, of_frames, of_lens, of_sizes, size_unexplained
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, measured, unmeasured
from tests.support.known_geometry import ring

RIG = ring(4, (640, 480), 600.0)
ALL = (0, 1, 2, 3)


def named(findings: list[Finding], measure: str) -> Finding:
    return next(f for f in findings if f.measure == measure)


def test_a_plain_camera_is_good() -> None:
    assert {f.verdict for v in range(4) for f in of_lens(RIG, v)} == {FindingVerdict.GOOD}
    assert {f.verdict for f in of_aim(RIG, ALL)} == {FindingVerdict.GOOD}
    assert of_sizes(RIG, 0, (640, 480), np.array([1.0, 0, 0])).verdict is FindingVerdict.GOOD


def test_a_principal_point_of_another_size_is_bad() -> None:
    k = RIG.intrinsics.copy()
    k[1, :2, 2] *= 2
    assert named(of_lens(replace(RIG, intrinsics=k), 1), "principal point").verdict is FindingVerdict.BAD


@pytest.mark.parametrize("by", ["epipolar distance", "agreement"])
def test_a_principal_point_of_a_crop_is_doubtful_where_the_pictures_bear_it_out(by: str) -> None:
    k = RIG.intrinsics.copy()
    k[1, :2, 2] *= 2
    own = of_lens(replace(RIG, intrinsics=k), 1)

    def told(*more: Finding) -> Finding:
        return named(confirmed([*own, *more]), "principal point")

    def by_lines(value: float, *names: str) -> Finding:
        return measured(by, names, value, "px", 1.0, 3.0, "off the lines", "calibrate again")

    fits = told(by_lines(0.5, "cam1", "cam2"))
    assert fits.verdict is FindingVerdict.DOUBTFUL
    assert "lines of other cameras" in fits.sentence
    assert fits.advice
    for others in (
        [],
        [by_lines(0.5, "cam0", "cam2")],
        [by_lines(0.5, "cam1", "cam2"), by_lines(2.0, "cam0", "cam1")],
        [unmeasured(by, ("cam1",), "px", 1.0, 3.0, "nothing in common")],
    ):
        assert told(*others).verdict is FindingVerdict.BAD
    assert confirmed(of_lens(RIG, 1)) == of_lens(RIG, 1)


def test_unequal_focal_lengths_are_told() -> None:
    k = RIG.intrinsics.copy()
    k[1, 0, 0] *= 1.05
    found = named(of_lens(replace(RIG, intrinsics=k), 1), "focal lengths")
    assert found.value == pytest.approx(0.05)
    assert found.verdict is FindingVerdict.DOUBTFUL


def test_a_lens_that_folds_back_within_the_picture_is_bad() -> None:
    """k1 = -1 folds at a radius of 1/sqrt(3), where 0.385 is shown;
    the corner lies at hypot(320, 240) / 600 = 0.667."""
    d = RIG.distortion.copy()
    d[0, 0] = -1.0
    found = of_lens(replace(RIG, distortion=d), 0)
    assert named(found, "lens model").value == pytest.approx(0.3849 / 0.6667, abs=1e-3)
    assert named(found, "lens model").verdict is FindingVerdict.BAD
    assert named(found, "lens distortion").verdict is FindingVerdict.BAD
    assert named(found, "lens distortion").advice


def test_what_undistortion_leaves_out_is_told() -> None:
    """The corners of a wide lens, of which the sides are kept; of a lens that hardly bends nothing is said."""
    d = RIG.distortion.copy()
    d[0, 0], d[1, 0] = -0.2, -0.01
    rig = replace(RIG, distortion=d)
    told = named(of_lens(rig, 0), "lens distortion").sentence
    assert told.endswith(f"; without it {left_out(rig, 0):.1%} of the picture, in its corners, is left out")
    assert 0.02 < left_out(rig, 0) < 0.06
    assert "left out" not in named(of_lens(rig, 1), "lens distortion").sentence


def test_a_letterbox_is_good_and_half_a_picture_is_not() -> None:
    rig = ring(2, (1088, 1920), 1600.0)
    assert of_sizes(rig, 0, (1080, 1920), np.array([1.00741, 0, -7.06])).verdict is FindingVerdict.GOOD
    assert of_sizes(rig, 0, (1080, 1920), np.array([0.5, 0, 0])).verdict is FindingVerdict.BAD
    unexplained = size_unexplained("cam0", (1080, 1920), (1088, 1920), "{crop: ...}")
    assert unexplained.verdict is FindingVerdict.BAD
    assert "{crop: ...}" in unexplained.advice


def test_a_camera_that_looks_away_is_told() -> None:
    """Turned by 60 degrees about its vertical axis."""
    poses = RIG.world_to_camera.copy()
    c, s = np.cos(np.pi / 3), np.sin(np.pi / 3)
    poses[2, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ poses[2, :3]
    verdicts = {f.cameras[0]: f.verdict for f in of_aim(replace(RIG, world_to_camera=poses), ALL)}
    assert verdicts[RIG.names[2]] is FindingVerdict.BAD
    assert of_aim(RIG.subset([0]), (0,))[0].verdict is FindingVerdict.UNKNOWN


def test_missing_frames_are_counted_against_all_cameras() -> None:
    found = of_frames(("a", "b"), [np.arange(100), np.arange(50)], (0, 1))
    assert [f.value for f in found] == [0.0, 0.5]
    assert [f.verdict for f in found] == [FindingVerdict.GOOD, FindingVerdict.BAD]


def test_the_advice_on_missing_frames_is_the_longest_stretch_that_all_have() -> None:
    even, dropped = np.arange(10, 60, 2), np.array([10, 14, 16, 18, 20, 40])
    assert "frames.range=14:21:2" in of_frames(("a", "b"), [even, dropped], (0, 1))[1].advice
    assert "leave out the shortest" in of_frames(("a", "b"), [np.arange(9), np.arange(20, 29)], (0, 1))[1].advice


def test_a_camera_that_is_not_believed_moves_no_other() -> None:
    """Neither the point that all look at nor the frames that they are to have."""
    poses = RIG.world_to_camera.copy()
    poses[2, :3, 3] += [3.0, 2.0, 0.0]
    moved, kept = replace(RIG, world_to_camera=poses), (0, 1, 3)
    aims = {f.cameras[0]: f.value for f in of_aim(moved, kept)}
    alone = {f.cameras[0]: f.value for f in of_aim(moved.subset(kept), (0, 1, 2))}
    assert {name: aims[name] for name in alone} == alone
    assert of_frames(("a", "b"), [np.arange(50), np.arange(100)], (0,))[0].value == 0.0
