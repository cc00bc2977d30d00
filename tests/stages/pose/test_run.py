"""Laws of the pose kernel: what it reads, whom it picks, how it fills, and that partitions do not matter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.io import Block
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.run import check, run, unknown_note
from posegaussian.stages.pose.stage import STAGE
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import BODY_25, COCO17, to_set
from tests.support.memory_inputs import MemoryInputs, run_stage
from tests.support.walking_skeleton import SKELETON, Joints2D, Joints3D, pixels, ring, roles, walk

NAMES = ("pose/joints2d", "pose/joints3d", "pose/heatmaps")


def pose(
    rig: Rig,
    frames: int,
    joints: Joints2D | None = None,
    joints3d: Joints3D | None = None,
    held_out: tuple[int, ...] = (),
    params: PoseParams | None = None,
    **more: Any,
) -> Any:
    sources: dict[str, Any] = {"joints": joints} | ({"joints3d": joints3d} if joints3d else {})
    facts = frozenset({"joints2d"} if joints else set()) | frozenset({"joints3d"} if joints3d else set())
    whole = run_stage(
        STAGE, params or PoseParams(), {}, rig, roles(rig, held_out), frames, sources=sources, facts=facts, **more
    )
    for name in NAMES:
        assert not [w for w in check(Block(name, whole[name]), params or PoseParams()) if "not finite" in w]
    return tuple(whole[n] for n in NAMES)


class Strided(MemoryInputs):
    """Inputs whose worked frames are every so manieth of the source."""

    step = 1

    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        numbers, valid = super().footage(array)
        return self.step * numbers, valid


def test_held_out_views_are_filled_from_the_others_and_never_read() -> None:
    rig, points = ring(6, size=96), walk(3)
    exact = pixels(rig, points)
    two, three, maps = pose(
        rig, 3, Joints2D.single(exact, forbidden={(f, v) for f in range(3) for v in (1, 4)}), held_out=(1, 4)
    )
    np.testing.assert_allclose(three[..., :3], points, atol=1e-6)  # stored as float32
    np.testing.assert_allclose(two, exact, atol=1e-4)
    assert maps.shape == (3, 6, 17, 24, 24)
    assert maps.dtype == np.float16
    assert (maps.max(axis=(3, 4)) > np.exp(-1.01)).all()


def test_missing_and_wrong_joints_are_replaced_by_reprojection_with_the_3d_score() -> None:
    rig, points = ring(8, size=128), walk(2)
    exact = pixels(rig, points)
    given = exact.copy()
    given[0, 3, 9] = 0  # missing
    given[0, 2, 7, :2] += 30  # wrong
    given[1, 5] = 0  # nobody found in that view
    given[1, 0, 4, 0] = np.nan  # a broken file
    given[1, 1, 2, 2] = 0.05  # not believed
    two, three, _ = pose(rig, 2, Joints2D.single(given))
    np.testing.assert_allclose(two[..., :2], exact[..., :2], atol=1e-3)
    assert two[0, 2, 7, 2] == three[0, 7, 3] == pytest.approx(7 / 8)
    assert two[0, 3, 9, 2] == three[0, 9, 3] == 1


def test_a_wrong_joint_of_somebody_small_in_a_large_picture_is_replaced() -> None:
    rig, points = ring(8, size=4096, focal=0.0625), walk(1)
    exact = pixels(rig, points)
    given = exact.copy()
    given[0, 2, 9, :2] += 24  # a sixth of the person, 0.6 % of the picture
    two, three, _ = pose(rig, 1, Joints2D.single(given), params=PoseParams(sigma_unit="px", sigma=2))
    np.testing.assert_allclose(two[..., :2], exact[..., :2], atol=1e-2)
    assert two[0, 2, 9, 2] == three[0, 9, 3] == pytest.approx(7 / 8)


def test_a_detection_that_agrees_stays_what_was_detected() -> None:
    rig, points = ring(5, size=128), walk(1)
    given = pixels(rig, points)
    given[..., :2] += np.random.default_rng(2).normal(0, 0.4, given[..., :2].shape)
    given[..., 2] = 0.75
    two, three, _ = pose(rig, 1, Joints2D.single(given))
    np.testing.assert_array_equal(two, given.astype(np.float32))
    assert np.abs(three[..., :3] - points).max() < 0.03


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 7])
def test_partitions_do_not_change_a_byte(length: int) -> None:
    rig, points = ring(5, size=64), walk(7)
    given = pixels(rig, points)
    rng = np.random.default_rng(3)
    given[..., :2] += rng.normal(0, 0.7, given[..., :2].shape)
    given[..., 2] = np.where(rng.random(given.shape[:-1]) < 0.2, 0, rng.uniform(0.3, 1, given.shape[:-1]))
    for a, b in zip(
        pose(rig, 7, Joints2D.single(given)), pose(rig, 7, Joints2D.single(given), length=length), strict=True
    ):
        assert a.tobytes() == b.tobytes()


def crowd(rig: Rig, order: np.random.Generator) -> tuple[np.ndarray, Joints2D]:
    """The subject in the middle, a second person behind in every view, an onlooker that only view 0 sees;
    in any order."""
    points = walk(4)
    subject = pixels(rig, points)
    other = pixels(rig, SKELETON[None] * [0.9, 0.9, 1.05] + np.array([-0.9, 0.7, 0.0]))[0]
    people = []
    for f in range(4):
        views = []
        for v in range(len(rig)):
            here = [subject[f, v], other[v]]
            if v == 0:
                here.append(np.column_stack([subject[f, v, :, :2] * 0.5 + 100, np.ones(17)]))
            views.append([here[i] for i in order.permutation(len(here))])
        people.append(views)
    return points, Joints2D(people)


def test_of_several_people_the_one_in_the_middle_is_taken_in_every_frame() -> None:
    rig = ring(5, size=256)
    points, first = crowd(rig, np.random.default_rng(4))
    two, three, _ = pose(rig, 4, first)
    np.testing.assert_allclose(three[..., :3], points, atol=1e-6)
    np.testing.assert_allclose(two, pixels(rig, points), atol=1e-4)
    shuffled, _, _ = pose(rig, 4, crowd(rig, np.random.default_rng(5))[1])
    np.testing.assert_allclose(shuffled, two, atol=1e-4)  # the order of the list decides nothing


def test_a_view_that_only_sees_somebody_else_is_filled() -> None:
    rig, points = ring(5, size=256), walk(1)
    exact = pixels(rig, points)
    exact[:, :, 9] = 0  # a joint of the subject that nobody sees
    people = [[[p] for p in exact[0]]]
    people[0][2] = [np.column_stack([SKELETON[:, 1] * 60 + 40, 200 - SKELETON[:, 2] * 60, np.full(17, 0.9)])]
    two, three, _ = pose(rig, 1, Joints2D(people))
    known = np.arange(17) != 9
    np.testing.assert_allclose(three[:, known, :3], points[:, known], atol=1e-6)
    np.testing.assert_allclose(two, exact, atol=1e-4)  # and it is not lent the stranger's


def test_frames_without_a_person_or_a_picture_are_unknown_or_filled() -> None:
    rig, points = ring(4, size=64), walk(3)
    exact = pixels(rig, points)
    reader = Joints2D.single(exact, forbidden={(2, 0)})
    reader.people[1] = [[], [], [], []]
    valid = np.ones((3, 4), bool)
    valid[2, 0] = False
    two, three, maps = pose(rig, 3, reader, valid_all=valid)
    assert not two[1].any()
    assert not three[1].any()
    assert not maps[1].any()
    np.testing.assert_allclose(two[[0, 2]], exact[[0, 2]], atol=1e-4)


def test_one_camera_passes_its_largest_person_through() -> None:
    rig, points = ring(1, size=128), walk(2)
    exact = pixels(rig, points)
    exact[0, 0, 5] = 0
    small = exact.copy()
    small[..., :2] = small[..., :2] * 0.3 + 60
    given = exact.copy()
    given[0, 0, 5] = [np.nan, 3.0, 0.9]  # not finite: not known
    two, three, maps = pose(rig, 2, Joints2D([[[small[f, 0], given[f, 0]]] for f in range(2)]))
    np.testing.assert_allclose(two, exact, atol=1e-4)
    assert not three.any()
    assert maps.any()


def test_given_3d_joints_are_projected_into_every_view_and_fill_what_2d_cannot_know() -> None:
    rig, points = ring(3, size=96), walk(2)
    given = np.concatenate([points, np.full((2, 17, 1), 0.5)], axis=-1)
    given[1, 3, 0] = np.nan
    expected = pixels(rig, points) * [1, 1, 0.5]
    expected[1, :, 3] = 0
    two, three, _ = pose(rig, 2, None, Joints3D(given), held_out=(2,))
    np.testing.assert_allclose(two, expected, atol=1e-4)
    assert not three[1, 3].any()
    alone = pixels(rig, points)
    alone[:, 1:] = 0
    alone[0, 0, 0, :2] += 50  # contradicts the 3D joint that is given
    two, three, _ = pose(rig, 2, Joints2D.single(alone), Joints3D(given))
    np.testing.assert_allclose(three[0], given[0], atol=1e-6)
    np.testing.assert_allclose(two[0, :, :, :2], expected[0, :, :, :2], atol=1e-4)


def test_joints_keep_their_set_and_heatmaps_are_coco() -> None:
    rig, points = ring(4, size=96), walk(1)
    exact = to_set(pixels(rig, points), "coco17", "body_25")
    two, three, maps = pose(rig, 1, Joints2D.single(exact, joint_set="body_25"))
    _, _, coco = pose(rig, 1, Joints2D.single(pixels(rig, points)))
    assert two.shape == (1, 4, 25, 3)
    assert not three[0, BODY_25.names.index("MidHip")].any()
    np.testing.assert_allclose(to_set(three, "body_25", "coco17")[..., :3], points, atol=1e-6)
    np.testing.assert_array_equal(maps, coco)


def test_sigma_in_metres_is_projected_and_unknown_depths_take_the_mean() -> None:
    near, far = ring(4, size=256, focal=1.2), ring(4, size=256, radius=5.2, focal=2.4)

    def spread(rig: Rig, **settings: Any) -> np.ndarray:
        maps = pose(rig, 1, Joints2D.single(pixels(rig, SKELETON[None])), params=PoseParams(**settings))[2][0].astype(
            np.float64
        )
        return np.sqrt(maps.sum(axis=(2, 3)) / (2 * np.pi))  # in cells

    depth = np.stack(
        [SKELETON @ r[2] + t[2] for r, t in zip(near.rotations, near.world_to_camera[:, :3, 3], strict=True)]
    )
    f = 1.2 * 256 * np.sqrt(1.02)
    # the tail below 1e-3 is missing
    np.testing.assert_allclose(spread(near, sigma=0.1), 0.1 * f / depth / 4, rtol=0.02)
    np.testing.assert_allclose(spread(near, sigma=8.0, sigma_unit="px"), 2.0, rtol=0.02)
    # twice as far, twice the focal length
    np.testing.assert_allclose(spread(far, sigma=0.1), spread(near, sigma=0.1), rtol=0.2)
    lonely = pixels(near, SKELETON[None])
    lonely[0, 1:, 9] = 0  # one view alone sees the left wrist
    maps = pose(near, 1, Joints2D.single(lonely), params=PoseParams(sigma=0.1))[2][0].astype(np.float64)
    mean = np.delete(depth[0], 9).mean()
    assert np.sqrt(maps[0, 9].sum() / (2 * np.pi)) == pytest.approx(0.1 * f / mean / 4, rel=0.02)
    assert not maps[1:, 9].any()


def test_the_crop_applies_to_video_pixels_only() -> None:
    rig, points = ring(4, size=96), walk(1)
    exact = pixels(rig, points)
    crop = np.array([[1.1, -4.0, 6.0], [0.9, 3.0, 1.0], [1, 0, 0], [1, 0, 0]])
    captured = exact.copy()
    captured[..., :2] = (exact[..., :2] - crop[:, None, 1:]) / crop[:, None, :1]
    two, _, _ = pose(rig, 1, Joints2D.single(captured), captured_to_calibrated=crop)
    np.testing.assert_allclose(two, exact, atol=1e-4)
    two, _, _ = pose(
        rig, 1, Joints2D.single(exact), captured_to_calibrated=crop, params=PoseParams(joints_frame="calibrated")
    )
    np.testing.assert_allclose(two, exact, atol=1e-4)


def test_check_refuses_what_is_impossible_and_warns_of_what_is_empty() -> None:
    good = np.ones((1, 17, 3), np.float32)
    assert check(Block("pose/joints2d", good, 0), PoseParams()) == []
    broken = good.copy()
    broken[0, 3, 1] = np.inf
    with pytest.raises(ValueError, match=r"pose/joints2d of view 2: 1 of 51 values are not finite"):
        check(Block("pose/joints2d", broken, 2), PoseParams())
    with pytest.raises(ValueError, match=r"pose/heatmaps.*bounds are 0 and 1"):
        check(Block("pose/heatmaps", np.full((1, 17, 2, 2), 1.5, np.float16), 0), PoseParams())
    assert "100% of the joints are unknown" in unknown_note("pose/joints3d", np.zeros((2, 17, 4)))[0]


def test_frames_in_which_nobody_is_are_said_once_and_not_of_every_camera() -> None:
    rig = ring(4, size=96)
    for there in (0, 1, 4):
        given = pixels(rig, walk(4))
        given[there:] = 0
        inputs = MemoryInputs(
            STAGE,
            PoseParams(bridge=0),
            {},
            rig,
            roles(rig),
            range(4),
            4,
            sources={"joints": Joints2D.single(given)},
            facts=frozenset({"joints2d"}),
        )
        blocks = list(run(inputs, PoseParams(bridge=0)))  # type: ignore[arg-type]
        told = [n for b in blocks for n in b.notes if "joints are unknown" in n]
        assert [n.split(":")[0] for n in told] == ["pose/joints3d"] * (there < 2)


def spoilt(rig: Rig, frames: int) -> tuple[np.ndarray, Joints2D]:
    """Points of a walk; its joints with left and right exchanged in a frame and in a view, and two of them hidden
    for a while."""
    points = walk(frames)
    given = pixels(rig, points)
    given[4] = given[4][:, list(COCO17.flips)]
    given[9:11, 2] = given[9:11, 2][:, list(COCO17.flips)]
    given[6:9, :, 9] = 0
    given[12:14, 1:, 16] = 0
    return points, Joints2D.single(given)


def test_sides_are_put_right_and_hidden_joints_bridged_and_the_report_says_so() -> None:
    rig = ring(6, size=256)
    points, given = spoilt(rig, 16)
    two, three, _ = pose(rig, 16, given)
    np.testing.assert_allclose(three[..., :3], points, atol=1e-4)
    np.testing.assert_allclose(two[..., :2], pixels(rig, points)[..., :2], atol=1e-2)
    assert (three[6:9, 9, 3] < 1).all()
    assert (three[..., 3] > 0.3).all()
    inputs = MemoryInputs(
        STAGE,
        PoseParams(),
        {},
        rig,
        roles(rig),
        range(3, 12),
        16,
        sources={"joints": given},
        facts=frozenset({"joints2d"}),
    )
    inputs = inputs.but(source_frames=np.arange(40, 58, 2))
    (note,) = next(iter(run(inputs, PoseParams()))).notes
    assert (
        note == "joints2d: left and right were exchanged, and put back, in 3 of 9 frames, first in frame 42 (frames by"
        " camera: cam00 1, cam01 1, cam02 3, cam03 1, cam04 1, cam05 1)"
    )


@pytest.mark.parametrize(
    ("step", "rate", "turned", "anywhere"),
    [(1, 5, False, False), (6, 30, False, False), (1, 4, True, False), (15, 30, True, False), (16, 30, True, True)],
)
def test_frames_that_lie_far_apart_tell_nothing_of_each_other(
    step: int, rate: float, turned: bool, anywhere: bool
) -> None:
    """Somebody who faces the other way in every second frame is the same with left and right exchanged, and a wrist
    that is not seen may be anywhere, but not as soon; consecutive frames at a usual rate put right what is wrong."""
    rig = ring(6, size=128)
    points = np.repeat(SKELETON[None], 8, axis=0)
    points[1::2] *= [-1, -1, 1]
    exact = pixels(rig, points)
    exact[3, :, 9] = 0
    given = Joints2D([[[exact[f // step, v]] for v in range(6)] for f in range(8 * step)])
    params = PoseParams()
    sources = {"joints": given}
    facts = frozenset({"joints2d"})
    inputs = Strided(STAGE, params, {}, rig, roles(rig), range(2, 6), 8, sources=sources, facts=facts)
    inputs.step = step
    inputs = inputs.but(source_frames=step * np.arange(2, 6), rate=rate)
    three = next(b.data for b in run(inputs, params) if b.array == "pose/joints3d")
    known = np.arange(17) != 9
    kept = [np.abs(three[f, known, :3] - points[2 + f, known]).max() < 1e-4 for f in range(4)]
    assert all(kept) == turned
    assert (three[1, 9, 3] == 0) == anywhere


def test_without_a_bridge_every_frame_stands_by_itself() -> None:
    rig = ring(6, size=256)
    points, given = spoilt(rig, 16)
    _, three, _ = pose(rig, 16, given, params=PoseParams(bridge=0))
    assert not three[6:9, 9].any()
    np.testing.assert_allclose(three[4, :, :3], points[4, list(COCO17.flips)], atol=1e-6)  # all views agree
    np.testing.assert_allclose(three[9, :, :3], points[9], atol=1e-6)
    alone = run_stage(
        STAGE,
        PoseParams(bridge=0),
        {},
        rig,
        roles(rig),
        16,
        1,
        sources={"joints": given},
        facts=frozenset({"joints2d"}),
    )
    assert alone["pose/joints3d"].tobytes() == three.tobytes()


@pytest.mark.parametrize("length", [1, 3, 5, 7])
def test_partitions_do_not_change_a_byte_of_what_is_mended(length: int) -> None:
    rig = ring(5, size=64)
    _, given = spoilt(rig, 16)
    for a, b in zip(pose(rig, 16, given), pose(rig, 16, given, length=length), strict=True):
        assert a.tobytes() == b.tobytes()
