"""Who is segmented where the joints in space are seen is the subject, though their own joints are wrong; nobody is whom
that leaves in doubt."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.contract.facts import ESTIMATED, SEGMENTED, TRACKED
from posegaussian.stages.contract.io import Block
from posegaussian.stages.pose.facts import HIDDEN
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.run import run
from posegaussian.stages.pose.stage import STAGE
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.joint_sets import to_set
from tests.support.memory_inputs import MemoryInputs
from tests.support.person_estimates import segmented

FACTS = frozenset({"joints2d", "several_frames", ESTIMATED, SEGMENTED, TRACKED})
WRONG = 2
"""The view whose joints are wrong."""
VIEWS, FRAMES, SIZE = 5, 2, 96


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(VIEWS, SIZE, FRAMES, 0)


def found(person: PersonCapture) -> dict[str, np.ndarray]:
    """Everybody found: somebody beside the subject, and the subject, whose joints one view puts elsewhere, so that no
    number is theirs there."""
    own = segmented(person)
    joints = np.zeros((FRAMES, VIEWS, 2, 33, 3), np.float32)
    joints[:, :, 1] = to_set(person.joints2d, "coco17", "blazepose33")
    joints[:, WRONG, 1, :, :2] = joints[:, WRONG, 1, ::-1, :2]
    region = np.repeat(own["detection/region"], 2, axis=2)
    region[:, :, 0, 0] += SIZE / 2  # beside: the same shape, seen half a picture farther right
    number = np.tile(np.array([-1, 0], np.int16), (FRAMES, VIEWS, 1))
    number[:, WRONG] = -1
    return {
        "detection/joints2d": joints,
        "detection/region": region,
        "detection/person": np.repeat(own["detection/person"], 2, axis=2),
        "people/number": number,
        "tracks/choice": np.array([0, 0, 1], np.int16),
    }


def blocks_of(person: PersonCapture, arrays: dict[str, np.ndarray]) -> list[Block]:
    """All that the stage yields."""
    params = PoseParams(heatmaps="drawn")
    inputs = MemoryInputs(
        STAGE, params, arrays, person.rig, person.views, range(FRAMES), FRAMES, facts=FACTS, joint_set="blazepose33"
    )
    return list(run(inputs, params))


def said(person: PersonCapture, arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Who is chosen [F, V], and whether the subject is alone [F], as the stage says."""
    blocks = blocks_of(person, arrays)
    (alone,) = (np.asarray(b.data)[:, 0] for b in blocks if b.array == "pose/alone")
    return np.stack([np.asarray(b.data) for b in blocks if b.array == "pose/chosen"], axis=1), alone


def test_who_is_segmented_on_the_joints_in_space_is_the_subject(person: PersonCapture) -> None:
    chosen, alone = said(person, found(person))
    np.testing.assert_array_equal(chosen, 1)
    np.testing.assert_array_equal(alone, 1)


def test_a_segmentation_beside_the_joints_is_nobody_s(person: PersonCapture) -> None:
    arrays = found(person)
    arrays["detection/person"][:, WRONG, 1] = 0
    chosen, _ = said(person, arrays)
    assert (chosen[:, WRONG] == -1).all()
    assert (np.delete(chosen, WRONG, axis=1) == 1).all()


def test_nobody_is_told_in_frames_in_which_somebody_else_is_followed(person: PersonCapture) -> None:
    arrays = found(person)
    arrays["people/number"][1, 0, 0] = 1  # somebody else, in another view of one frame
    chosen, alone = said(person, arrays)
    assert chosen[:, WRONG].tolist() == [1, -1]
    assert alone.tolist() == [1, 0]


def test_where_hardly_a_joint_is_seen_nobody_is_told(person: PersonCapture) -> None:
    arrays = found(person)
    joints = arrays["detection/joints2d"]
    joints[:, np.arange(VIEWS) != WRONG, 1, 6:] = 0  # the head alone is in space
    assert (said(person, arrays)[0][:, WRONG] == -1).all()


def passing(person: PersonCapture, nearer: float) -> dict[str, np.ndarray]:
    """What is found where in one view of the first frame somebody stands before the subject, `nearer` times as large,
    and the estimator finds them twice in place of the subject."""
    arrays = found(person)
    joints, region = arrays["detection/joints2d"], arrays["detection/region"]
    joints[1, WRONG] = joints[1, 0]  # the subject itself is found in the second frame
    arrays["people/number"][1, WRONG] = arrays["people/number"][1, 0]
    own = np.array(person.joints2d[:1, WRONG], np.float32)
    own[..., :2] = SIZE / 2 + nearer * (own[..., :2] - SIZE / 2)
    own[((own[..., :2] < 0) | (own[..., :2] > SIZE)).any(axis=-1), 2] = 0
    joints[0, WRONG] = to_set(own, "coco17", "blazepose33")
    region[0, WRONG, :] = [SIZE / 2, SIZE / 2, nearer * SIZE, 0.0]
    return arrays


def test_who_hides_the_subject_is_not_taken_for_the_subject_and_it_is_said(person: PersonCapture) -> None:
    blocks = blocks_of(person, passing(person, 1.45))
    chosen = {b.view: np.asarray(b.data).tolist() for b in blocks if b.array == "pose/chosen"}
    assert chosen.pop(WRONG) == [HIDDEN, 1]
    assert all(c == [1, 1] for c in chosen.values())
    (alone,) = (np.asarray(b.data)[:, 0].tolist() for b in blocks if b.array == "pose/alone")
    assert alone == [0, 1], "somebody else is there"
    told = {b.view: b.notes for b in blocks if b.array == "pose/chosen" and b.notes}
    assert list(told) == [WRONG]
    assert "hides the subject in frames 0;" in told[WRONG][0]


def test_somebody_found_as_large_as_the_subject_on_its_joints_hides_nobody(person: PersonCapture) -> None:
    arrays = passing(person, 1.05)
    arrays["detection/joints2d"][0, WRONG, :, ::3, 0] += SIZE / 4  # joints too wrong to be the subject's
    assert not (said(person, arrays)[0] == HIDDEN).any()
