"""More than one person in a picture is named, with what it means and what to set."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.estimators.interface import Found
from posegaussian.stages.inspection.finding import FindingVerdict
from posegaussian.stages.inspection.footage import Footage, scope_of
from posegaussian.stages.inspection.outlook import expected
from posegaussian.stages.inspection.people import SIGHT, SURE, Finder, of_people, of_sight, people
from tests.support.inspection_plans import planned
from tests.support.known_geometry import ring

RIG = ring(4)


def person(height: float, joints: int = 17) -> np.ndarray:
    """[17, 3] joints one above the other, the first of them seen."""
    out = np.zeros((17, 3))
    out[:, 1] = np.linspace(0, height, 17)
    out[:joints, 2] = 0.9
    return out


@dataclass
class Joints:
    """People by view in every frame."""

    given: dict[int, list[np.ndarray]]
    joint_set: str = "coco17"
    asked: list[tuple[int, int]] = field(default_factory=list)

    def read(self, view: int, number: int) -> np.ndarray:
        self.asked.append((view, number))
        return np.array(self.given.get(view, [person(100)])).reshape(-1, 17, 3)


def footage(*more: str, **readers: Any) -> Footage:
    facts = frozenset({*more, "joints2d"} if "joints" in readers else more)
    return Footage(
        scope_of(RIG, RIG, np.tile([1.0, 0, 0], (4, 1)), facts),
        np.tile([1.0, 0, 0], (4, 1)),
        RIG.size,
        [np.arange(20)] * 4,
        25.0,
        readers,
    )


@pytest.mark.parametrize(
    ("found", "count"),
    [
        ([], 0),
        ([person(100)], 1),
        ([person(100), person(60)], 2),
        ([person(100), person(10)], 1),
        ([person(100), person(60, joints=4)], 1),
        ([np.zeros((17, 3))], 0),
    ],
)
def test_people_are_those_with_joints_that_are_not_tiny(found: list[np.ndarray], count: int) -> None:
    assert people(np.array(found).reshape(-1, 17, 3)) == count


@pytest.mark.parametrize("kind", ["joints", "found"])
def test_a_second_person_is_named_with_the_cameras_that_show_them(kind: str) -> None:
    (f,) = of_people(footage(**{kind: Joints({1: [person(100), person(80)]})}), planned(RIG, matte="plate"))
    assert f.verdict is FindingVerdict.DOUBTFUL
    assert f.value == pytest.approx(0.25)
    assert "cam1 up to 2" in f.sentence
    assert "one is reconstructed" in f.sentence
    assert "frames.matte: person" in f.advice
    assert "detection.box: {cam1: " in f.advice


def test_the_estimator_sees_whom_the_given_joints_leave_out() -> None:
    looked = Joints({2: [person(100), person(80)]})
    (f,) = of_people(footage(joints=Joints({}), found=looked), planned(RIG))
    assert f.verdict is FindingVerdict.DOUBTFUL
    assert "cam2" in f.sentence
    assert len(looked.asked) == 4, "one picture a camera"


def test_one_person_is_good_only_where_somebody_looked() -> None:
    (looked,) = of_people(footage(joints=Joints({}), found=Joints({})), planned(RIG))
    assert looked.verdict is FindingVerdict.GOOD
    (told,) = of_people(footage(joints=Joints({})), planned(RIG))
    assert told.verdict is FindingVerdict.UNKNOWN
    assert "models fetch blazepose" in told.sentence
    (nothing,) = of_people(footage(), planned(RIG))
    assert nothing.verdict is FindingVerdict.UNKNOWN


EMPTY: dict[int, list[np.ndarray]] = {v: [] for v in range(4)}


@pytest.mark.parametrize("kind", ["joints", "found"])
def test_pictures_without_anybody_are_bad_and_nothing_is_expected_of_them(kind: str) -> None:
    (f,) = of_sight(footage(**{kind: Joints(EMPTY)}))
    assert (f.measure, f.value, f.verdict) == (SIGHT, 0.0, FindingVerdict.BAD)
    assert "nobody was found in any" in f.sentence
    assert "frames.range" in f.advice
    assert "detection.zoom" in f.advice
    assert expected(planned(RIG), [f]) == "expected: nothing, as nobody was found in any picture that was looked at"


def test_one_who_is_in_some_pictures_is_enough() -> None:
    class Leaving(Joints):
        def read(self, view: int, number: int) -> np.ndarray:
            return super().read(view, number) if number < 10 else np.zeros((0, 17, 3))

    (f,) = of_sight(footage(found=Leaving({})))
    assert f.verdict is FindingVerdict.GOOD
    assert 0 < float(f.value or 0) < 1


def test_a_camera_that_shows_nobody_while_two_others_do_is_doubtful() -> None:
    whole, one = of_sight(footage(found=Joints({2: []})))
    assert whole.verdict is FindingVerdict.GOOD
    assert whole.value == pytest.approx(0.75)
    assert (one.cameras, one.verdict) == (("cam2",), FindingVerdict.DOUBTFUL)
    assert "cam2" in one.advice
    assert len(of_sight(footage(found=Joints({1: [], 2: [], 3: []})))) == 1, "one camera alone accuses nobody"


def test_whom_the_given_joints_name_the_estimator_need_not_find() -> None:
    (f,) = of_sight(footage(joints=Joints({}), found=Joints(EMPTY)))
    assert f.verdict is FindingVerdict.GOOD


@pytest.mark.parametrize("fact", ["masks", "joints3d"])
def test_a_subject_that_is_told_otherwise_need_not_be_a_person(fact: str) -> None:
    assert of_sight(footage(fact, found=Joints(EMPTY))) == []
    assert of_sight(footage()) == [], "nobody looked"


def test_the_finder_believes_only_whom_the_estimator_is_sure_of() -> None:
    class Estimator:
        joint_set = "coco17"

        def find(self, picture: np.ndarray, most: int) -> Found:
            nobody = Found.nobody(17)
            joints = np.stack([person(100), person(80), person(60)]).astype(np.float32)
            return Found(
                joints,
                np.zeros((3, 4), np.float32),
                nobody.heatmaps,
                nobody.person,
                np.array([0.9, SURE + 0.05, SURE - 0.05], np.float32),
            )

    class Pictures:
        def read(self, view: int, numbers: list[int]) -> list[np.ndarray]:
            return [np.zeros((8, 8, 3), np.uint8) for _ in numbers]

    assert Finder(Pictures(), Estimator(), RIG).read(0, 3).shape == (2, 17, 3)  # type: ignore[arg-type]
