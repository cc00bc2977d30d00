"""The pose stage on the capsule person and on the real four-camera capture."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.points import project
from posegaussian.stages.pose.left_right_swaps import HEAD, Sides
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.stage import STAGE
from posegaussian.stages.pose.tracking import Followed, follow
from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from posegaussian.storage.model.cameras import Rig, from_integer_centres, points_from_integer_centres, rigid
from posegaussian.storage.model.joint_sets import to_set
from tests.support.memory_inputs import MemoryInputs, run_stage
from tests.support.walking_skeleton import Joints2D, ring

BALANCE = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "captures" / "balance"
CAMERAS = ("cam01", "cam02", "cam03", "cam04")
CROP = 1088 / 1080  # cam01 and cam02: the calibrated picture scaled into 1080 columns, 7 black rows above and below


def test_noisy_joints_of_the_capsule_person_come_back_in_every_view() -> None:
    person = capture_person(views=6, size=48, frames=3, held_out=2, motion="kick")
    rng = np.random.default_rng(0)
    given = person.joints2d.copy()
    given[..., :2] += rng.normal(0, 0.15, given[..., :2].shape)  # of 48 px
    given[rng.random(given.shape[:3]) < 0.1] = 0
    wrong = rng.random(given.shape[:3]) < 0.02
    given[wrong, :2] += 12.0
    forbidden = {(f, v) for f in range(3) for v in person.views.held_out}
    found = run_stage(
        STAGE,
        PoseParams(),
        {},
        person.rig,
        person.views,
        3,
        sources={"joints": Joints2D.single(given, forbidden=forbidden)},
        facts=frozenset({"joints2d"}),
    )
    assert (found["pose/joints3d"][..., 3] > 0).all()
    off = np.linalg.norm(found["pose/joints2d"][..., :2] - person.joints2d[..., :2], axis=-1)
    assert off.max() < 1.0  # px; the bound on outliers is 0.96 px, noise reaches 0.6
    held_out = list(person.views.held_out)
    assert np.median(off[:, held_out]) < 0.15  # better than any one detection


def calibration() -> Rig:
    tables = tomllib.loads((BALANCE / "calibration.toml").read_text())
    cameras = [tables[f"int_{name}_img"] for name in CAMERAS]
    poses = [rigid(cv2.Rodrigues(np.array(c["rotation"]))[0], np.array(c["translation"])) for c in cameras]
    lenses = [np.pad(c["distortions"], (0, 4)) for c in cameras]
    return Rig(
        CAMERAS,
        from_integer_centres(np.array([c["matrix"] for c in cameras])),
        np.stack(lenses),
        np.stack(poses),
        np.array([c["size"] for c in cameras], dtype=np.int64),
    )


def detections(view: int, number: int) -> list[np.ndarray]:
    name = CAMERAS[view]
    people = json.loads(
        (BALANCE / "keypoints" / "openpose_body25b" / f"{name}_json" / f"{name}.{number:04d}.json").read_text()
    )["people"]
    joints = [
        np.array(p["pose_keypoints_2d"], dtype=np.float64).reshape(-1, 3) for p in people if p.get("pose_keypoints_2d")
    ]
    return [np.concatenate([points_from_integer_centres(j[:, :2]), j[:, 2:]], axis=-1) for j in joints]


@pytest.mark.captures
@pytest.mark.skipif(not BALANCE.is_dir(), reason=f"no capture at {BALANCE}; set POSEGAUSSIAN_CAPTURES")
@pytest.mark.parametrize("joints_frame", ["video", "calibrated"])
def test_balance_is_triangulated_to_its_detector_accuracy(joints_frame: str) -> None:
    source = calibration()
    rig = Rig(source.names, source.intrinsics, np.zeros((4, 8)), source.world_to_camera, source.size)
    crop = np.array([[CROP, 0, -7 * CROP], [CROP, 0, -7 * CROP], [1, 0, 0], [1, 0, 0]])
    people = [[detections(v, f) for v in range(4)] for f in range(0, 100, 10)]
    params = PoseParams(joints_frame=joints_frame)  # type: ignore[arg-type]
    views = Views(CAMERAS, (0, 1, 2, 3), ())
    found = run_stage(
        STAGE,
        params,
        {},
        rig,
        views,
        10,
        sources={"joints": Joints2D(people, joint_set="body_25b")},
        facts=frozenset({"joints2d"}),
        source_rig=source,
        captured_to_calibrated=crop,
    )
    joints3d = found["pose/joints3d"].astype(np.float64)
    assert (joints3d[..., 3] > 0).mean() > 0.98
    again = np.moveaxis(project(rig, joints3d[..., :3])[0], 1, 2)
    off = np.linalg.norm(found["pose/joints2d"][..., :2] - again, axis=-1)[
        found["pose/joints2d"][..., 2] != joints3d[:, None, :, 3].astype(np.float32)
    ]
    assert 5 < np.median(off) < 11  # px at 1088 x 1920, of which 7-8 are the detector's own 5 px grid
    body = to_set(joints3d, "body_25b", "trc21")[0]
    assert 1.5 < body[:, 2].max() < 1.95  # a standing man in metres, Z up, feet near the floor
    assert -0.1 < body[:, 2].min() < 0.2


@pytest.mark.captures
@pytest.mark.skipif(not BALANCE.is_dir(), reason=f"no capture at {BALANCE}; set POSEGAUSSIAN_CAPTURES")
def test_sides_exchanged_in_real_detections_are_put_back_and_no_others() -> None:
    """A frame in ten wrong in all four views, a picture in ten in one:
    of a view alone all but the undecidable come back."""
    frames, rng, sides = 24, np.random.default_rng(0), Sides.of("body_25b")
    source = calibration()
    rig = Rig(source.names, source.intrinsics, np.zeros((4, 8)), source.world_to_camera, source.size)
    crop = np.array([[CROP, 0, -7 * CROP], [CROP, 0, -7 * CROP], [1, 0, 0], [1, 0, 0]])
    people = [[detections(v, f) for v in range(4)] for f in range(frames)]
    wrong = np.zeros((frames, 4, 3), dtype=bool)
    wrong[[5, 14]] = True
    for f in (1, 2, 8, 9, 11, 17, 18, 21):
        wrong[f, rng.integers(4)] = ([True] * 3, [False, True, False], [True, False, False])[rng.integers(3)]
    spoilt = [[[sides.exchange(p, wrong[f, v]) for p in people[f][v]] for v in range(4)] for f in range(frames)]

    def followed(given: list[list[list[np.ndarray]]]) -> Followed:
        inputs = MemoryInputs(
            STAGE,
            PoseParams(),
            {},
            rig,
            Views(CAMERAS, (0, 1, 2, 3), ()),
            range(frames),
            frames,
            sources={"joints": Joints2D(given, joint_set="body_25b")},
            facts=frozenset({"joints2d"}),
            source_rig=source,
            captured_to_calibrated=crop,
        )
        return follow(inputs, PoseParams(), "body_25b")

    right, mended = followed(people), followed(spoilt)
    assert not right.exchanged.any()
    found, asked = mended.exchanged[..., :HEAD], wrong[..., :HEAD]
    assert not (found & ~asked).any()
    assert (found & asked).sum() >= 0.9 * asked.sum()
    assert (np.linalg.norm((mended.points - right.points)[..., :3], axis=-1) > 0.05).mean() < 0.01


def test_a_ring_of_fifty_views_is_handled() -> None:
    rig = ring(50, size=96)
    person = np.zeros((1, 50, 17, 3))
    point = np.array([0.1, 0.2, 1.0])
    person[0, :, 0] = np.concatenate([project(rig, point)[0], np.ones((50, 1))], axis=-1)
    found = run_stage(
        STAGE,
        PoseParams(),
        {},
        rig,
        Views(rig.names, tuple(range(50)), ()),
        1,
        sources={"joints": Joints2D.single(person)},
        facts=frozenset({"joints2d"}),
    )
    np.testing.assert_allclose(found["pose/joints3d"][0, 0], [*point, 1.0], atol=1e-6)
