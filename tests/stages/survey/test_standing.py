"""How cameras stand is asked in frames that show somebody: of one who comes late as of one who stays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.trust import Told
from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.silhouettes.coherence import INCOHERENT, Outlined, contradiction
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.survey.measures.standing import STANDING
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.stages.survey.stage import STAGE
from posegaussian.stages.survey.standing.lacking import lacking
from posegaussian.storage.model.cameras import Rig
from tests.support.frame_readers import Pictures
from tests.support.memory_inputs import run_stage

VIEWS, FRAMES, SIZE = 8, 10, 128


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=VIEWS, size=SIZE, frames=1, held_out=0)


def survey_of(rig: Rig, person: PersonCapture, masks: list[list[np.ndarray]], view: int) -> dict[str, Any]:
    """What the stage writes of one view, with masks by view and frame."""
    sources = {
        "pictures": Pictures([[np.zeros((SIZE, SIZE, 3), np.uint8)] * FRAMES] * VIEWS),
        "masks": Pictures(masks),
    }
    facts = frozenset({STANDING, "masks"})
    return run_stage(STAGE, SurveyParams(), {}, rig, person.views, FRAMES, view=view, sources=sources, facts=facts)


@pytest.mark.parametrize("there", [range(FRAMES), range(5, FRAMES), (4, 5), (9,)])
def test_a_camera_that_was_bumped_is_found_though_nobody_is_in_most_frames(
    person: PersonCapture, there: range | tuple[int, ...]
) -> None:
    turns = np.zeros((VIEWS, 3))
    turns[2, 1] = 6.0 / person.rig.intrinsics[2, 0, 0]
    masks = [[person.mask[0, v] * (n in there) for n in range(FRAMES)] for v in range(VIEWS)]
    row = survey_of(turned(person.rig, turns), person, masks, 2)[STANDING][2]
    off = (row[:3] + turns[2]) * person.rig.intrinsics[2, 0, 0]
    assert row[:3].any()
    assert np.abs(off[:2]).max() < 1.0


@pytest.mark.parametrize("since", [4, 8])
def test_a_camera_that_was_moved_in_mid_take_is_noted_with_the_frames(person: PersonCapture, since: int) -> None:
    """By masks of a subject at rest, rolled by whole pixels; the sample here is every frame."""
    moved = [np.roll(person.mask[0, 2], 6, axis=1) if n >= since else person.mask[0, 2] for n in range(FRAMES)]
    masks = [moved if v == 2 else [person.mask[0, v]] * FRAMES for v in range(VIEWS)]
    row = survey_of(person.rig, person, masks, 2)[STANDING][2]
    assert tuple(row[4:]) == (Told.MOVED, since - 1, since)
    assert row[3] == pytest.approx(6 / SIZE, abs=1 / SIZE)


def cut(mask: np.ndarray) -> np.ndarray:
    """Without the feet."""
    rows = np.nonzero(mask.any(axis=1))[0]
    out = mask.copy()
    out[int(rows[0] + 0.85 * (rows[-1] - rows[0])) :] = 0
    return out


@pytest.mark.parametrize("which", [(3,), (1, 5), (0, 2, 3)], ids=["one", "two", "three"])
def test_masks_that_lack_something_are_noted_and_no_others(person: PersonCapture, which: tuple[int, ...]) -> None:
    masks = [[cut(person.mask[0, v]) if v in which else person.mask[0, v]] * FRAMES for v in range(VIEWS)]
    rows = [survey_of(person.rig, person, masks, v)[STANDING][v] for v in range(VIEWS)]
    assert [v for v, row in enumerate(rows) if row[4] == Told.LACKING] == list(which)
    assert not any(row[:4].any() for row in rows)


def test_nobody_lacks_anything_who_is_turned_or_out_of_step(person: PersonCapture) -> None:
    """Their own outlines contradict the others, and what is cut from masks does not."""
    walking = capture_person(views=VIEWS, size=SIZE, frames=12)
    turns = np.zeros((VIEWS, 3))
    turns[2] = 0.1, 0.1, 0.1
    late = {v: walking.mask[6 if v == 2 else 0, v] for v in range(VIEWS)}
    right = {v: person.mask[0, v] for v in range(VIEWS)}
    for rig, masks in ((walking.rig, late), (turned(person.rig, turns), right)):
        outlined = Outlined.of(rig, masks)
        assert contradiction(rig, [outlined], range(VIEWS)) > INCOHERENT * SIZE / 512
        assert lacking(rig, [outlined]) == frozenset()
    assert lacking(person.rig, [Outlined.of(person.rig, right | {2: cut(right[2])})]) == {2}


def test_a_camera_whose_masks_are_late_is_noted_with_the_frames() -> None:
    """Of a kick, every fourth picture of it; of one that is mirrored, or of masks of somebody at rest, nothing tells of
    another moment."""
    kick = capture_person(views=6, size=96, frames=4 * (FRAMES + 2) + 1, motion="kick", held_out=0)

    def row(late: int, paint: Callable[[np.ndarray], np.ndarray] = lambda mask: mask) -> np.ndarray:
        shown = np.clip(np.arange(FRAMES) + 2 - late * (np.arange(6) == 2)[:, None], 0, FRAMES + 2)
        masks = [[paint(kick.mask[4 * n, v]) if v == 2 else kick.mask[4 * n, v] for n in shown[v]] for v in range(6)]
        sources = {"pictures": Pictures([[np.zeros((96, 96, 3), np.uint8)] * FRAMES] * 6), "masks": Pictures(masks)}
        facts = frozenset({STANDING, "masks"})
        written = run_stage(
            STAGE, SurveyParams(), {}, kick.rig, kick.views, FRAMES, view=2, sources=sources, facts=facts
        )
        return np.asarray(written[STANDING][2])

    found = {late: row(late) for late in (1, -2)}
    assert {late: tuple(told[4:6]) for late, told in found.items()} == {1: (Told.LATE, 1), -2: (Told.LATE, -2)}
    assert found[1][3] > 0
    assert row(0, lambda mask: mask[::-1].copy())[4] == Told.WRONG
    assert not row(0).any()
