"""The person an estimator found for whom joints were given: the same one, turned or not, and never a bystander."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.stage import STAGE
from posegaussian.stages.pose.subject_match import FLIPS, nearest
from posegaussian.storage.model.joint_sets import joint_set, to_set
from tests.support.frame_readers import Joints
from tests.support.memory_inputs import run_stage
from tests.support.walking_skeleton import pixels, ring, roles, walk

FRAMES = 3


def test_given_joints_choose_among_the_people_found_in_every_view() -> None:
    rig = ring(4, size=256)
    own = pixels(rig, walk(FRAMES))  # [F, V, 17, 3]
    beside = own + np.array([40.0, 5.0, 0.0])
    people = np.zeros((FRAMES, 4, 3, 33, 3), np.float32)
    # another detector puts joints elsewhere
    seen = np.random.default_rng(0).normal(0, 1.5, own.shape) * [1, 1, 0] + own
    people[:, :, 0], people[:, :, 1] = to_blazepose(beside), to_blazepose(seen)
    people[1, 2, 1] = to_blazepose(seen[1, 2][FLIPS])  # seen from behind it comes out mirrored
    people[2, 3, 1] = 0  # not found at all
    facts = frozenset({"joints2d", "segmented", "several_frames"})
    out = run_stage(
        STAGE,
        PoseParams(),
        {
            "detection/joints2d": people,
            "detection/person": np.zeros((FRAMES, 4, 3, 8, 8), np.uint8),
            "detection/region": np.zeros((FRAMES, 4, 3, 4), np.float32),
        },
        rig,
        roles(rig),
        FRAMES,
        sources={"joints": PerView(own)},
        facts=facts,
    )
    wanted = np.ones((FRAMES, 4))
    wanted[2, 3] = -1
    np.testing.assert_array_equal(out["pose/chosen"], wanted)
    np.testing.assert_allclose(out["pose/joints2d"], own, atol=0.01)  # they are the given ones, px in float32


def test_too_few_joints_choose_nobody() -> None:
    person = np.concatenate([np.random.default_rng(1).uniform(0, 100, (17, 2)), np.ones((17, 1))], axis=1)
    few = person * (np.arange(17) < 4)[:, None]
    assert nearest(person[None], person) == 0
    assert nearest(person[None], few) == -1
    assert nearest(few[None], person) == -1
    assert nearest(np.zeros((0, 17, 3)), person) == -1


class PerView(Joints):
    """[F, V, J, 3] one person in each view."""

    def read(self, view: int, number: int) -> np.ndarray:
        return self.joints[None, number, view]


def to_blazepose(joints: np.ndarray) -> np.ndarray:
    """COCO-17 joints in BlazePose's order; what COCO lacks is unknown."""
    out = to_set(joints, "coco17", "blazepose33")
    assert out.shape[-2] == len(joint_set("blazepose33"))
    return out.astype(np.float32)
