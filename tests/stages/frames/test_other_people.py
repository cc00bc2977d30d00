"""Two people in one picture: a mask holds one of them, whoever stands before the other, and one person alone is cut out
as before."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.facts import TRACKED
from posegaussian.stages.contract.io import Block
from posegaussian.stages.frames.bodies.body import body_depth, body_shape, pixels_per_metre
from posegaussian.stages.frames.bodies.other_people import others_in
from posegaussian.stages.frames.bodies.own_joints import not_too_broad, own_joints
from posegaussian.stages.frames.params import FramesParams
from posegaussian.stages.frames.run import run
from posegaussian.stages.frames.stage import STAGE
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person, render
from posegaussian.stages.simulator.subjects.motion import joints_at, pose
from posegaussian.storage.model.joint_sets import COCO17
from tests.support.frame_readers import Pictures, wall
from tests.support.memory_inputs import MemoryInputs
from tests.support.person_estimates import FACTS, hints_of, segmented

SIZE, VIEWS = 160, 6
CLOSE, BEHIND, CHILD = ((0.35, 0.0, 0.0), 1.0), ((-0.35, 0.0, 0.0), 1.0), ((0.4, 0.1, 0.0), 0.5)
"""Where somebody else stands, metres, and how tall they are: before the subject for the first camera, or behind it."""
ONE_FRAME = FACTS - {"several_frames"}
SPILLS = 5
"""Px beyond the subject up to which an estimator takes somebody else for it."""


def two(place: tuple[float, ...], tall: float) -> tuple[PersonCapture, np.ndarray, dict[str, np.ndarray]]:
    """A person before mottled walls and somebody in other colours, `tall` times as tall, at a place; whose a pixel is
    [V, h, w], 1 the subject's and 2 theirs; and what is found, by an estimator that segments
    what touches the subject with it."""
    person = capture_person(VIEWS, SIZE, 1, 0, motion="stand")
    owner, color = np.zeros((VIEWS, SIZE, SIZE), int), person.color.copy()
    bones, union = pose("stand", 0.0), person.mask.copy()
    for v in range(VIEWS):
        camera = person.rig.world_to_camera[v].copy()  # moved and shrunk, so that the person need not be
        camera[:3, 3] = (camera[:3, 3] + camera[:3, :3] @ np.array(place)) / tall
        shown, mask, depth = render(bones, person.rig.intrinsics[v], camera, (SIZE, SIZE), 2)
        first = (mask > 127) & ((person.depth[0, v] <= 0) | (tall * depth < person.depth[0, v]))
        color[0, v][first] = shown[first][:, [2, 0, 1]]
        owner[v] = np.where(first, 2, (person.mask[0, v] > 127).astype(int))
        around = cv2.dilate((owner[v] == 1).astype(np.uint8), np.ones((2 * SPILLS + 1,) * 2, np.uint8)) > 0
        union[0, v] = np.where(first & ~around, 0, np.where(first, 255, union[0, v]))
        color[0, v][owner[v] == 0] = wall(SIZE, v)[owner[v] == 0].astype(np.uint8)
    others = np.zeros((1, 16, 17, 4), np.float32)
    others[0, 1] = np.concatenate([tall * joints_at(bones) + np.array(place), np.ones((17, 1))], axis=1)
    both = replace(person, color=color, mask=union)
    arrays = segmented(both, 64) | {"pose/others3d": others, "pose/alone": np.zeros((1, 1), np.uint8)}
    return replace(person, color=color), owner, arrays


def blocks_of(person: PersonCapture, arrays: dict[str, np.ndarray], facts: frozenset[str], view: int) -> list[Block]:
    inputs: Any = MemoryInputs(
        STAGE,
        FramesParams(matte="person"),
        arrays,
        person.rig,
        person.views,
        range(1),
        1,
        view=view,
        sources={"pictures": Pictures([list(person.color[:, v]) for v in range(VIEWS)])},
        facts=facts,
    )
    return list(run(inputs, inputs.params))


def masks_of(person: PersonCapture, arrays: dict[str, np.ndarray], facts: frozenset[str] = ONE_FRAME) -> np.ndarray:
    """[V, h, w] uint8 of all views."""
    return np.stack([np.asarray(blocks_of(person, arrays, facts, v)[1].data)[0] for v in range(VIEWS)])


@pytest.mark.parametrize(("place", "tall"), [CLOSE, BEHIND, CHILD])
def test_of_two_people_a_mask_holds_one(place: tuple[float, ...], tall: float) -> None:
    person, owner, arrays = two(place, tall)
    before, found = (masks_of(person, arrays, f) > 127 for f in (ONE_FRAME, ONE_FRAME | {TRACKED}))
    share = [
        np.array([m[o == 2].sum() / m.sum() for m, o in zip(masks, owner, strict=True)]) for masks in (before, found)
    ]
    assert share[0].max() > 0.15, "an easy pair tells nothing"
    assert share[1].max() <= 0.05
    kept = np.sort([m[o == 1].mean() for m, o in zip(found, owner, strict=True)])
    assert kept[1:].min() > 0.9, "in all views but the one from which the subject is hidden"


def test_one_person_alone_is_cut_out_as_before() -> None:
    person, _, arrays = two(*CLOSE)
    arrays["pose/others3d"][:] = 0
    np.testing.assert_array_equal(masks_of(person, arrays, ONE_FRAME | {TRACKED}), masks_of(person, arrays))


def test_where_somebody_stands_before_the_subject_a_view_neither_carves_nor_confirms() -> None:
    person, owner, arrays = two((0.5, 0.1, 0.0), 1.0)
    arrays["detection/person"] = segmented(person)["detection/person"]
    hidden = cv2.resize((owner[0] == 2).astype(np.uint8), (256, 256)) > 0
    arrays["detection/person"][0, 0, 0][hidden] = 0  # a view that segments the subject as it shows it
    carved, kept = (hints_of(person, arrays, 3, f).support(3, 0) for f in (FACTS, FACTS | {TRACKED}))
    assert carved is not None
    assert kept is not None
    own = person.mask[0, 3] > 127
    assert (carved[0][own] < 0.5).mean() > 0.05, "what another view does not show would be ruled out"
    assert (kept[0][own] < 0.5).mean() < 0.01
    assert (kept[1][own] > 0.5).mean() > (carved[1][own] > 0.5).mean() + 0.05


def test_it_is_said_where_somebody_hides_much_of_the_subject() -> None:
    person, _, arrays = two(*CLOSE)
    told = [blocks_of(person, arrays, ONE_FRAME | {TRACKED}, v)[1].notes for v in range(VIEWS)]
    assert ["hides more than 30% of the subject in frames 0;" in " ".join(t) for t in told] == [True] + 5 * [False]


def test_who_stands_behind_the_subject_hides_nothing_of_it() -> None:
    person, _, arrays = two(*BEHIND)
    joints, others = person.joints3d[0].copy(), arrays["pose/others3d"][0].astype(np.float64)
    told = others_in(person.rig, 0, joints, others, "coco17", (SIZE, SIZE))
    assert told is not None
    assert told.hides == 0
    assert not told.before.any()
    across = others_in(person.rig, 3, joints, others, "coco17", (SIZE, SIZE))
    assert across is not None
    assert across.hides > 0.6


def test_bodies_have_the_depth_of_their_nearest_bone() -> None:
    person = capture_person(VIEWS, SIZE, 1, 0, motion="kick")
    for v in range(VIEWS):
        camera = person.rig.world_to_camera[v]
        depth = person.joints3d[0, :, :3] @ camera[2, :3] + camera[2, 3]
        scale = pixels_per_metre(person.joints2d[0, v], "coco17")
        found = body_depth(person.joints2d[0, v], depth, "coco17", (SIZE, SIZE), scale)
        shape = body_shape(person.joints2d[0, v], "coco17", (SIZE, SIZE), scale)
        np.testing.assert_array_equal(np.isfinite(found), shape)
        seen = shape & (person.depth[0, v] > 0)
        off = found[seen] - person.depth[0, v][seen]  # of the skin, which lies before the bone
        assert 0 < np.median(off) < 0.1
        assert (np.abs(off - 0.05) < 0.2).mean() > 0.95


def test_a_bone_that_leads_to_somebody_else_ends_the_limb() -> None:
    joints = np.concatenate([joints_at(pose("stand", 0.0)), np.ones((17, 1))], axis=1)
    np.testing.assert_array_equal(own_joints(joints, "coco17"), joints)
    elbow, wrist = (COCO17.names.index(n) for n in ("LElbow", "LWrist"))
    joints[elbow, :3] += [0.0, 0.35, 0.1]
    joints[wrist, :3] += [0.0, 0.35, 0.1]
    lost = own_joints(joints, "coco17")[:, 3] == 0
    assert set(np.flatnonzero(lost)) == {elbow, wrist}
    joints[COCO17.names.index("LShoulder"), 3] = 0
    assert (own_joints(joints, "coco17")[[elbow, wrist], 3] > 0).all(), "nothing is known of the bone"


def test_a_side_that_is_drawn_to_the_subject_goes_back_with_its_limb() -> None:
    other = np.concatenate([joints_at(pose("stand", 0.0)), np.ones((17, 1))], axis=1)
    subject = other + np.array([0.0, 0.4, 0.0, 0.0])
    np.testing.assert_allclose(not_too_broad(other, subject, "coco17"), other)
    side = [j for j, n in enumerate(COCO17.names) if n[0] == "L" and n[1:] in ("Hip", "Knee", "Ankle")]
    if other[side, 1].mean() < other[:, 1].mean():
        subject = other - np.array([0.0, 0.4, 0.0, 0.0])
    drawn = other.copy()
    drawn[side, 1] += 0.2 * np.sign(subject[0, 1] - other[0, 1])
    back = not_too_broad(drawn, subject, "coco17")
    assert np.abs(back - other)[side].max() < 0.06
    np.testing.assert_array_equal(np.delete(back, side, axis=0), np.delete(other, side, axis=0))


def test_where_the_subject_is_wholly_hidden_the_plate_tells_of_somebody_else() -> None:
    person, owner, arrays = two(*BEHIND)
    arrays |= {"survey/plate": np.stack([wall(SIZE, v).astype(np.uint8) for v in range(VIEWS)])}
    arrays |= {"survey/spread": np.full((VIEWS, SIZE, SIZE), 2, np.uint8)}
    arrays["pose/chosen"] = np.full((1, VIEWS), -1, np.int32)
    centre, joints = person.rig.centres[0], person.joints3d[0, :, :3]
    arrays["pose/others3d"][0, 1, :, :3] = centre + 0.75 * (joints - centre)  # seen in the same place, and nearer
    assert (owner[0] == 1).sum() > 2000
    assert not np.asarray(blocks_of(person, arrays, FACTS | {TRACKED}, 0)[1].data).any()
    arrays["pose/others3d"][:] = 0
    assert np.asarray(blocks_of(person, arrays, FACTS | {TRACKED}, 0)[1].data).any()


def test_in_frames_without_the_subject_the_plate_tells_of_nobody_who_is_followed() -> None:
    """Of a bystander before the subject comes, and after; a subject whom the detector missed stays."""
    person, owner, arrays = two((0.0, 1.1, 0.0), 1.0)
    plates = np.stack([wall(SIZE, v).astype(np.uint8) for v in range(VIEWS)])
    arrays |= {"survey/plate": plates, "survey/spread": np.full((VIEWS, SIZE, SIZE), 2, np.uint8)}
    arrays["pose/chosen"] = np.full((1, VIEWS), -1, np.int32)
    arrays |= {k: np.zeros_like(arrays[k]) for k in ("pose/joints2d", "pose/joints3d", "detection/person")}
    alone = replace(person, color=np.where((owner == 1)[None, ..., None], plates[None], person.color))
    both, bystander = (masks_of(p, arrays, FACTS | {TRACKED}) > 127 for p in (person, alone))
    apart = [v for v in range(VIEWS) if cv2.connectedComponents((owner[v] > 0).astype(np.uint8))[0] == 3]
    assert len(apart) >= 3, "people who touch are one part of what differs from the plate"
    shares = np.array([[both[v][owner[v] == n].mean() for n in (1, 2)] for v in apart])
    assert shares[:, 0].min() > 0.9
    assert shares[:, 1].max() < 0.02
    assert not bystander.any()
    arrays["pose/others3d"][:] = 0
    assert (masks_of(alone, arrays, FACTS | {TRACKED}) > 127).any(axis=(1, 2)).all(), "nobody is known to be there"
