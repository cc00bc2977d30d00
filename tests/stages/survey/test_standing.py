"""How cameras stand is asked in frames that show somebody: of one who comes late as of one who stays."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.survey.measures.standing import STANDING
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.stages.survey.stage import STAGE
from tests.support.frame_readers import Pictures
from tests.support.memory_inputs import run_stage

VIEWS, FRAMES, SIZE = 8, 10, 128


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=VIEWS, size=SIZE, frames=1, held_out=0)


@pytest.mark.parametrize("there", [range(FRAMES), range(5, FRAMES), (4, 5), (9,)])
def test_a_camera_that_was_bumped_is_found_though_nobody_is_in_most_frames(
    person: PersonCapture, there: range | tuple[int, ...]
) -> None:
    turns = np.zeros((VIEWS, 3))
    turns[2, 1] = 6.0 / person.rig.intrinsics[2, 0, 0]
    masks = [[person.mask[0, v] * (n in there) for n in range(FRAMES)] for v in range(VIEWS)]
    sources = {
        "pictures": Pictures([[np.zeros((SIZE, SIZE, 3), np.uint8)] * FRAMES] * VIEWS),
        "masks": Pictures([list(m) for m in masks]),
    }
    out = run_stage(
        STAGE,
        SurveyParams(),
        {},
        turned(person.rig, turns),
        person.views,
        FRAMES,
        view=2,
        sources=sources,
        facts=frozenset({STANDING, "masks"}),
    )
    row = out[STANDING][2]
    off = (row[:3] + turns[2]) * person.rig.intrinsics[2, 0, 0]
    assert row[:3].any()
    assert np.abs(off[:2]).max() < 1.0
