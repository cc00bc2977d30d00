"""Which pictures the survey looks at."""

import numpy as np
import pytest

from posegaussian.stages.contract.io import Views
from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.stages.survey.stage import STAGE
from tests.support.frame_readers import Joints, Pictures
from tests.support.memory_inputs import run_stage


class Unreadable(Pictures):
    def read(self, view: int, numbers: object) -> object:  # type: ignore[override]
        raise AssertionError("a picture was decoded")


@pytest.mark.parametrize("asked", [frozenset({"survey/motion"}), frozenset()])
def test_pictures_are_not_decoded_for_what_joints_tell(asked: frozenset[str]) -> None:
    person = capture_person(2, 16, 8, 0, "kick")
    pictures = Unreadable([[np.zeros((16, 16, 3), np.uint8)] * 8] * 2)
    sources = {"pictures": pictures, "joints": Joints(person.joints2d[:, 0])}
    out = run_stage(
        STAGE,
        SurveyParams(),
        {},
        person.rig,
        Views(person.rig.names, (0, 1), ()),
        8,
        view=0,
        sources=sources,
        facts=frozenset({"joints2d"}) | asked,
    )
    assert set(out) == {"survey/sample"} | asked
    if asked:
        assert out["survey/motion"][0, 2] > 0


def test_nothing_follows_from_a_view_that_is_no_source() -> None:
    person = capture_person(2, 16, 8, 0, "kick")
    sources = {
        "pictures": Unreadable([[np.zeros((16, 16, 3), np.uint8)] * 8] * 2),
        "joints": Joints(person.joints2d[:, 0]),
    }
    out = run_stage(
        STAGE,
        SurveyParams(),
        {},
        person.rig,
        Views(person.rig.names, (1,), (0,)),
        8,
        view=0,
        sources=sources,
        facts=frozenset({"joints2d", "survey/motion", "survey/noise"}),
    )
    assert not out["survey/motion"].any()
    assert not out["survey/noise"].any()
