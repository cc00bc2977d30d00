"""The detection stage with an estimator that knows its answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posegaussian.stages.contract.facts import BLAZEPOSE, GIVEN_JOINTS
from posegaussian.stages.contract.io import Block
from posegaussian.stages.detection.guided import body_region
from posegaussian.stages.detection.params import DetectionParams, estimator_choice, refusal
from posegaussian.stages.detection.reader import EstimatedJoints
from posegaussian.stages.detection.run import check
from posegaussian.stages.detection.stage import STAGE
from posegaussian.stages.estimators.turned import Turned, quarter_turns, turned_back
from posegaussian.stages.imaging.regions import to_own, to_picture
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.stage import STAGE as POSE
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set
from tests.support.acting_estimator import Actor, Numbered
from tests.support.memory_inputs import run_stage
from tests.support.walking_skeleton import pixels, ring, roles, walk

FRAMES, SIZE = 4, 256
RIG = ring(5, SIZE)
POINTS = walk(FRAMES)
SUBJECT = pixels(RIG, POINTS)
"""[F, V, 17, 3] the subject as every camera sees it."""
ONLOOKER = pixels(RIG, POINTS + np.array([-0.9, 0.9, 0.0]))


def actor(blind: tuple[tuple[int, int], ...] = ()) -> Actor:
    """Finds the subject, but in `blind` (frame, view) the onlooker instead."""
    both = [[[SUBJECT[f, v], ONLOOKER[f, v]] for v in range(len(RIG))] for f in range(FRAMES)]
    return Actor(
        [[[ONLOOKER[f, v]] if (f, v) in blind else [SUBJECT[f, v]] for v in range(len(RIG))] for f in range(FRAMES)],
        both,
    )


def detect(
    estimator: Actor,
    params: DetectionParams | None = None,
    length: int | None = None,
    held_out: tuple[int, ...] = (),
    missing: tuple[tuple[int, int], ...] = (),
    rig: Rig = RIG,
) -> dict[str, np.ndarray]:
    valid = np.ones((FRAMES, len(rig)), bool)
    for f, v in missing:
        valid[f, v] = False
    sources = {"pictures": Numbered(FRAMES, tuple(rig.size[0]), missing), "estimator": estimator}
    return run_stage(
        STAGE,
        params or DetectionParams(),
        {},
        rig,
        roles(rig, held_out),
        FRAMES,
        length,
        sources=sources,
        facts=frozenset({"detected", "joints2d"}),
        valid_all=valid,
    )


def test_everybody_found_is_kept_and_nobody_pads() -> None:
    out = detect(actor())
    np.testing.assert_allclose(out["detection/joints2d"][:, :, 0], SUBJECT, atol=1e-3)
    assert not out["detection/joints2d"][:, :, 1:].any()
    assert (out["detection/region"][:, :, 0, 2] > 0).all()
    assert not out["detection/person"][:, :, 1:].any()


def test_held_out_views_and_missing_pictures_are_not_looked_at() -> None:
    estimator = actor()
    out = detect(estimator, held_out=(2,), missing=((1, 0),))
    assert not out["detection/joints2d"][:, 2].any()
    assert not out["detection/joints2d"][1, 0].any()
    assert {(f, v) for _, f, v in estimator.asked} == {(f, v) for f in range(FRAMES) for v in (0, 1, 3, 4)} - {(1, 0)}


def test_where_a_view_found_somebody_else_it_looks_where_the_others_see_the_subject() -> None:
    estimator = actor(blind=((2, 1),))
    out = detect(estimator)
    assert [a for a in estimator.asked if a[0] == "look"] == [("look", 2, 1)]
    np.testing.assert_allclose(out["detection/joints2d"][2, 1, 0], SUBJECT[2, 1], atol=1e-3)
    np.testing.assert_allclose(out["detection/joints2d"][2, 1, 1], ONLOOKER[2, 1], atol=1e-3)


@pytest.mark.parametrize(("size", "focal"), [(256, 1.0), (4096, 0.0625)])
def test_whom_a_view_mirrors_is_looked_at_again_however_small_in_a_large_picture(size: int, focal: float) -> None:
    rig = ring(5, size=size, focal=focal)
    right = pixels(rig, POINTS)
    mirrored = right.copy()
    mirrored[2, 0] = mirrored[2, 0][list(joint_set("coco17").flips)]
    found, both = ([[[p] for p in views] for views in seen] for seen in (mirrored, right))
    estimator = Actor(found, both)
    detect(estimator, rig=rig)
    assert [a for a in estimator.asked if a[0] == "look"] == [("look", 2, 0)]


@pytest.mark.parametrize("length", [1, 3])
def test_partitions_change_no_byte(length: int) -> None:
    whole, cut = (detect(actor(blind=((0, 3), (2, 1))), length=n) for n in (None, length))
    for name in whole:
        assert whole[name].tobytes() == cut[name].tobytes(), name


def test_a_box_leaves_out_who_stands_outside_and_names_where_to_look() -> None:
    left, top = ONLOOKER[..., :2].min(axis=(0, 2))[1]
    right, bottom = ONLOOKER[..., :2].max(axis=(0, 2))[1]
    box = [float(n) for n in (left, top, right, bottom)]
    estimator = actor()
    out = detect(estimator, DetectionParams(box={"cam01": box}))
    np.testing.assert_allclose(out["detection/joints2d"][:, 1, 0], ONLOOKER[:, 1], atol=1e-3)
    assert not out["detection/joints2d"][:, 1, 1:].any()
    # The box is the user's word: the other views do not overrule it.
    assert [a for a in estimator.asked if a[0] == "look"] == [("look", f, 1) for f in range(FRAMES)]


def test_pose_takes_the_subject_and_its_own_heatmaps() -> None:
    found = detect(actor(blind=((2, 1),)))
    out = run_stage(
        POSE, PoseParams(), found, RIG, roles(RIG), FRAMES, facts=frozenset({"detected", "segmented", "joints2d"})
    )
    np.testing.assert_allclose(out["pose/joints3d"][..., :3], POINTS, atol=2e-3)
    assert (out["pose/chosen"] == 0).all()
    maps = out["pose/heatmaps"].astype(np.float64)
    rows, columns = np.mgrid[: maps.shape[3], : maps.shape[4]]
    mass = maps.sum(axis=(3, 4))
    centre = (
        np.stack([(maps * columns).sum(axis=(3, 4)), (maps * rows).sum(axis=(3, 4))], axis=-1) / mass[..., None] * 4 + 2
    )
    # The bell is sampled on cells of the region, again on those of the view, and cut below 1e-3:
    # a quarter of a 4 px cell.
    np.testing.assert_allclose(centre, SUBJECT[..., :2], atol=1.0)
    assert maps.max(axis=(3, 4)).min() > 0.8
    drawn = run_stage(
        POSE,
        PoseParams(heatmaps="drawn"),
        found,
        RIG,
        roles(RIG),
        FRAMES,
        facts=frozenset({"detected", "segmented", "joints2d"}),
    )
    assert drawn["pose/joints3d"].tobytes() == out["pose/joints3d"].tobytes()
    assert drawn["pose/heatmaps"].tobytes() != out["pose/heatmaps"].tobytes()


def test_the_survey_s_reader_looks_once_at_a_picture() -> None:
    estimator = actor()
    pictures = Numbered(FRAMES, (SIZE, SIZE), ((3, 2),))
    reader = EstimatedJoints(pictures, estimator, RIG)
    reader.look_at(2, [0, 1, 3, 7])
    np.testing.assert_allclose(reader.read(2, 1)[0], SUBJECT[1, 2], atol=1e-3)
    assert reader.read(2, 3).shape == (0, 17, 3)
    EstimatedJoints(Numbered(FRAMES, (SIZE, SIZE)), estimator, RIG).read(2, 0)
    assert estimator.asked == [("find", 0, 2), ("find", 1, 2)]


def test_a_body_s_region_turns_with_it_and_holds_all_of_it() -> None:
    joints = SUBJECT[0, 0, :, :2]
    for angle in (-2.0, 0.0, 0.7):
        c, s = np.cos(angle), np.sin(angle)
        turned = (joints - 100) @ np.array([[c, s], [-s, c]]) + 100
        region = body_region(turned, np.ones(17, bool), "coco17")
        own = to_own(turned, region)
        assert ((own > 0.05) & (own < 0.95)).all()
        straight = to_own(joints, body_region(joints, np.ones(17, bool), "coco17"))
        np.testing.assert_allclose(own, straight, atol=1e-9)


def test_what_auto_means_is_said() -> None:
    auto = DetectionParams()
    assert estimator_choice(auto, frozenset({GIVEN_JOINTS, BLAZEPOSE}))[0] == "files"
    assert estimator_choice(auto, frozenset({BLAZEPOSE}))[0] == "blazepose"
    answer, why = estimator_choice(auto, frozenset())
    assert answer == "none"
    assert "posegaussian models fetch blazepose" in why
    assert "posegaussian models fetch blazepose" in str(refusal(DetectionParams(estimator="blazepose"), frozenset()))
    assert "detection.model" in str(refusal(DetectionParams(estimator="onnx"), frozenset()))
    assert "import them" in str(refusal(DetectionParams(estimator="files"), frozenset()))


def test_impossible_values_are_refused() -> None:
    broken = np.zeros((1, 1, 17, 3), np.float32)
    broken[0, 0, 3, 2] = 1.5
    with pytest.raises(ValueError, match=r"scores run from 0 to 1\.5"):
        check(Block("detection/joints2d", broken, 0), DetectionParams())
    broken[0, 0, 3, 0] = np.nan
    with pytest.raises(ValueError, match="1 of 51 values are not finite"):
        check(Block("detection/joints2d", broken, 0), DetectionParams())
    with pytest.raises(ValueError, match="left < right"):
        DetectionParams(box={"cam01": [3.0, 0.0, 1.0, 5.0]})


TURNS = [0, 1, 2, 3, 1]
"""Quarters counter-clockwise that bring each view's picture back upright."""


def rolled() -> np.ndarray:
    """[F, V, 17, 3] the subject in the pictures of the same cameras, each rolled by quarters about its axis."""
    k, poses = RIG.intrinsics.copy(), RIG.world_to_camera.copy()
    for v, quarters in enumerate(TURNS):
        a = -quarters * np.pi / 2
        poses[v] = np.array([[np.cos(a), np.sin(a), 0, 0], [-np.sin(a), np.cos(a), 0, 0], *np.eye(4)[2:]]) @ poses[v]
        k[v, :2, 2] = turned_back(k[v, :2, 2], (SIZE, SIZE), quarters)
        k[v, [0, 1], [0, 1]] = np.roll(k[v, [0, 1], [0, 1]], quarters)
    return pixels(replace(RIG, intrinsics=k, world_to_camera=poses), POINTS)


def test_an_estimator_is_shown_people_upright_and_its_joints_come_back() -> None:
    """What the actor finds in the picture turned upright is the subject as the level ring sees it."""
    seen = rolled()
    for v, k in enumerate(TURNS):
        turned = Turned(actor(), k)
        shown = np.full((SIZE, SIZE, 3), (1, v, 0), np.uint8)
        (joints,) = turned.find(shown, 3).joints
        np.testing.assert_allclose(joints[:, :2], seen[1, v, :, :2], atol=1e-3)
    level = RIG.subset([0, 2])
    assert [quarter_turns(level, v) for v in (0, 1)] == [0, 0]


@pytest.mark.parametrize("quarters", range(4))
def test_points_regions_and_pictures_turn_together(quarters: int) -> None:
    """A mark in a picture that is no square is found where the turned picture has it, and a region's own coordinates
    keep their meaning."""
    picture = np.zeros((40, 64, 3), np.uint8)
    picture[10, 50] = 255
    row, column = (int(i) for i in np.argwhere(np.rot90(picture, quarters)[..., 0])[0])
    np.testing.assert_allclose(turned_back(np.array([column + 0.5, row + 0.5]), (64, 40), quarters), [50.5, 10.5])
    region = np.array([20.0, 30.0, 8.0, 0.3])
    back = Turned(actor(), quarters).leaning(np.array([*turned_back(region[:2], (64, 40), quarters), *region[2:]]))
    own = np.array([[0.2, 0.9], [0.7, 0.1]])
    np.testing.assert_allclose(
        to_picture(own, back), turned_back(to_picture(own, region), (64, 40), quarters), atol=1e-9
    )


def test_a_ring_whose_pictures_lie_on_their_side_is_turned_upright() -> None:
    for k in range(4):
        a = -k * np.pi / 2
        turn = np.array([[np.cos(a), np.sin(a), 0, 0], [-np.sin(a), np.cos(a), 0, 0], *np.eye(4)[2:]])
        rig = replace(RIG, world_to_camera=turn @ RIG.world_to_camera)
        # Cameras that all hang upside down are believed: up is up in their pictures.
        assert {quarter_turns(rig, v) for v in range(len(rig))} == {k if k % 2 else 0}
