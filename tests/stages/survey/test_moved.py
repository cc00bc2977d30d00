"""A camera that was moved in mid-take is told with the moment; what errs all the time, or once, was not moved."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.silhouettes.coherence import Outlined, Standing, standing
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.survey.standing.moved import without_moved
from posegaussian.storage.model.cameras import Rig

SIZE, FRAMES = 128, 8
NUMBERS = 10 * np.arange(FRAMES)


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=6, size=SIZE, frames=FRAMES, held_out=0)


def bumped(rig: Rig, by: dict[int, float]) -> Rig:
    """Some cameras turned by px about their upright axis."""
    turns = np.zeros((len(rig), 3))
    for v, px in by.items():
        turns[v, 1] = px / rig.intrinsics[v, 0, 0]
    return turned(rig, turns)


def masks_of(person: PersonCapture, rig: Rig, frame: int) -> dict[int, np.ndarray]:
    """What cameras that stand as in `rig` see of a frame, drawn by how far each pixel's ray is turned."""
    out = {}
    for v in range(len(rig)):
        k, right = person.rig.intrinsics[v], person.rig.rotations[v]
        seen = k @ rig.rotations[v] @ right.T @ np.linalg.inv(k)
        out[v] = cv2.warpPerspective(person.mask[frame, v], seen, (SIZE, SIZE), flags=cv2.INTER_NEAREST)
    return out


def found(person: PersonCapture, written: Rig, stands: list[Rig]) -> Standing:
    def outlined(number: int) -> Outlined:
        return Outlined.of(written, masks_of(person, stands[number // 10], number // 10))

    return without_moved(written, NUMBERS, outlined, standing(written, [outlined(20), outlined(50)]))


@pytest.mark.parametrize(("since", "by"), [(2, {2: 5.0}), (6, {2: 5.0}), (4, {1: 5.0, 4: -8.0})])
def test_the_moment_is_told(person: PersonCapture, since: int, by: dict[int, float]) -> None:
    rig = person.rig
    told = found(person, rig, [rig if n < since else bumped(rig, by) for n in range(FRAMES)])
    assert set(told.moved) == set(by)
    assert not told.turns.any()
    assert not told.wrong
    for v, moved in told.moved.items():
        assert (moved.before, moved.after) == (10 * (since - 1), 10 * since)
        assert moved.by[1] * rig.intrinsics[v, 0, 0] == pytest.approx(by[v], abs=1.5)


def test_a_camera_that_is_turned_all_the_time_or_once_was_not_moved(person: PersonCapture) -> None:
    right, wrong = person.rig, bumped(person.rig, {2: 5.0})
    always = found(person, right, [wrong] * FRAMES)
    assert not always.moved
    assert set(np.flatnonzero(always.turns.any(axis=1))) == {2}
    for once in (0, 3, 7):
        assert not found(person, right, [wrong if n == once else right for n in range(FRAMES)]).moved
