"""Scenes that are like captures: the eight for reporting hold what they promise, others follow from any seed."""

from collections import Counter

import numpy as np
import pytest

from posegaussian.stages.geometry.projection import project
from posegaussian.stages.simulator.capture_scenes import CAPTURE_LIKE_SEEDS, LIKENESSES, capture_like_scene
from posegaussian.stages.simulator.scene import faults
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.subjects.splits import (
    KEPT_OUTFITS,
    KEPT_SUBJECTS,
    OPEN_SUBJECTS,
    VALIDATION_SUBJECT,
    cast,
)

REPORTED = [capture_like_scene(s) for s in CAPTURE_LIKE_SEEDS]


def test_the_reporting_scenes_hold_what_captures_hold() -> None:
    assert tuple(LIKENESSES) == tuple(CAPTURE_LIKE_SEEDS)
    assert not [f for s in REPORTED for f in faults(s)]
    assert Counter(s.rig.cameras for s in REPORTED) == {16: 2, 8: 2, 6: 2, 4: 2}
    people, outfits = zip(*(cast(s.seed) for s in REPORTED), strict=True)
    assert Counter(people) == dict.fromkeys(KEPT_SUBJECTS, 2)
    assert Counter(outfits) == dict.fromkeys(KEPT_OUTFITS, 2)
    assert Counter(s.frames for s in REPORTED)[1] == 1
    assert {c.thing for s in REPORTED for c in s.subject.carries} == {"helmet", "bag", "board"}
    assert sum(bool(s.subject.straps) for s in REPORTED) >= 4
    assert sum(s.subject.hair.strands > 0 for s in REPORTED) >= 4
    assert sum(s.effects.soft_matte is not None for s in REPORTED) >= 3
    assert sum(s.effects.camera_gain is not None for s in REPORTED) == 2
    assert sum(s.rig.roll == 90.0 for s in REPORTED) == 2
    assert any(s.rig.tilt for s in REPORTED)
    assert any(s.rig.roll_spread for s in REPORTED)
    worn = {(c.material, c.pattern) for s in REPORTED for c in (s.subject.upper, s.subject.lower)}
    assert {"leather", "lacquer", "satin", "cotton"} <= {m for m, _ in worn}
    assert "print" in {p for _, p in worn}


def test_any_seed_below_the_kept_ones_gives_a_scene_with_the_people_it_may_show() -> None:
    held = []
    for seed in (*range(60), 8000, 8999):
        s = capture_like_scene(seed)
        assert not faults(s)
        assert s == capture_like_scene(seed)
        assert cast(seed)[0] in (VALIDATION_SUBJECT if seed >= 8000 else OPEN_SUBJECTS)
        held.append((bool(s.subject.straps), bool(s.subject.carries), s.subject.hair.strands > 0, s.rig.cameras))
    assert all(len(set(column)) > 1 for column in zip(*held, strict=True))
    for seed in (9000, 9099, 9108):
        with pytest.raises(ValueError, match="9100-9107 are for reporting"):
            capture_like_scene(seed)


def test_cameras_and_frames_may_be_chosen_and_change_nothing_else() -> None:
    asked = capture_like_scene(9101, cameras=4, size=64, frames=1)
    own = capture_like_scene(9101, size=64)
    assert (asked.rig.cameras, asked.frames, own.rig.cameras, own.frames) == (4, 1, 8, 3)
    assert (asked.subject, asked.motion) == (own.subject, own.motion)
    assert capture_like_scene(9103, frames=3).frames == 1


@pytest.mark.parametrize("seed", [9102, 9104])
def test_nobody_is_cut_off(seed: int) -> None:
    s = capture_like_scene(seed, size=256, frames=1)
    staged = stage(s)
    vertices, rig = staged.take.actors[0].vertices(0.0), staged.take.rig
    uv = np.stack([project(vertices, rig.intrinsics[v], rig.world_to_camera[v])[0] for v in range(len(rig))])
    assert uv.min() > 0
    assert uv.max() < 256
    assert np.ptp(uv, axis=1).max(axis=1).min() > 0.4 * 256, "and everybody is large"
