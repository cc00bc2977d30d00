"""More than one person in a picture is named, with what it means and what to set."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.estimators.interface import Found
from posegaussian.stages.inspection.finding import FindingVerdict
from posegaussian.stages.inspection.footage import Footage, scope_of
from posegaussian.stages.inspection.outlook import expected
from posegaussian.stages.inspection.people import SIGHT, SURE, Finder, of_people, of_sight, of_stature, where_looked
from posegaussian.stages.survey.algorithms.joints import people
from tests.stages.following.test_following import at, filmed
from tests.support.inspection_plans import planned
from tests.support.known_geometry import ring
from tests.support.walking_skeleton import ring as subjects_ring

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


USUAL = [10, 3, 16]
"""Of 20 frames and four cameras: the middle one, and two away from the ends."""


class Coming(Joints):
    """Somebody from a frame on, and nobody before."""

    first = 12

    def read(self, view: int, number: int) -> np.ndarray:
        return super().read(view, number) if number >= self.first else np.zeros((0, 17, 3))


@dataclass
class Masks:
    """Masks of four cameras that hold somebody from a frame on, some never."""

    first: int
    blind: tuple[int, ...] = ()
    asked: set[int] = field(default_factory=set)

    def read(self, view: int, numbers: list[int]) -> Iterator[np.ndarray]:
        for n in numbers:
            self.asked.add(n)
            out = np.zeros((20, 20), np.uint8)
            out[5:15, 5:15] = 255 * (n >= self.first and view not in self.blind)
            yield out


@pytest.mark.parametrize("kind", ["joints", "found"])
def test_who_comes_in_late_is_looked_at_there_and_the_frames_are_named(kind: str) -> None:
    late = footage(**{kind: Coming({})})
    assert late.looked_at
    assert min(late.looked_at) >= Coming.first
    sight, *_ = of_sight(late)
    assert sight.verdict is FindingVerdict.GOOD
    (told,) = where_looked(late)
    assert "in frame 10 of 0..19, nobody was found" in told
    assert "frames.range" in told
    (alone,) = of_people(late, planned(RIG))
    assert "nobody" not in alone.sentence


def test_the_frames_of_one_who_is_in_the_middle_are_the_usual_ones_and_no_others_are_asked_for() -> None:
    """The estimator takes seconds a picture, and what was measured before is measured again of the same frames."""
    found, masks = Joints({}), Masks(first=10, blind=(0, 1))
    for there in (footage(found=found), footage("masks", masks=masks)):
        assert there.looked_at == USUAL
        of_sight(there)
        assert where_looked(there) == []
    assert {n for _, n in found.asked} == set(USUAL)
    assert masks.asked == set(USUAL)


def test_nobody_is_in_sight_only_after_the_estimator_was_asked_elsewhere_and_the_frames_are_named() -> None:
    nobody = Joints(EMPTY)
    (f,) = of_sight(footage(found=nobody))
    assert {n for _, n in nobody.asked} == {3, 6, 10, 13, 16}
    assert "in any of the 20 pictures that were looked at, of frames 3, 6, 10, 13, 16 of 0..19" in f.sentence


def test_no_estimator_is_asked_where_a_subject_is_that_need_not_be_a_person() -> None:
    nobody = Joints(EMPTY)
    told = footage("joints3d", found=nobody)
    assert told.looked_at == USUAL
    assert of_sight(told) == where_looked(told) == nobody.asked == []


def test_frames_are_chosen_by_what_masks_hold_and_masks_that_hold_nobody_promise_nothing() -> None:
    late = footage("masks", masks=Masks(first=15), found=Joints({}))
    assert min(late.looked_at) >= 15
    assert of_sight(late) == []
    assert "few masks" in where_looked(late)[0]
    (f,) = of_sight(footage("masks", masks=Masks(first=99), found=Joints({})))
    assert (f.measure, f.verdict) == (SIGHT, FindingVerdict.BAD)
    assert "hold nobody" in f.sentence
    assert expected(planned(RIG), [f]).startswith("expected: nothing")


def test_a_camera_whose_masks_hold_nobody_while_those_of_others_do_is_doubtful() -> None:
    (f,) = of_sight(footage("masks", masks=Masks(first=0, blind=(2,))))
    assert (f.cameras, f.verdict) == (("cam2",), FindingVerdict.DOUBTFUL)
    assert "its masks hold nobody" in f.sentence
    assert "views.sources" in f.advice
    assert "frames.matte: person" in f.advice


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
        def numbers(self, view: int) -> np.ndarray:
            return np.array([2, 3])

        def read(self, view: int, numbers: list[int]) -> list[np.ndarray]:
            return [np.zeros((8, 8, 3), np.uint8) for _ in numbers]

    finder = Finder(Pictures(), Estimator(), RIG)  # type: ignore[arg-type]
    assert finder.read(0, 3).shape == (2, 17, 3)
    assert finder.read(0, 4).shape == (0, 17, 3), "nobody is in a frame that the view lacks"


@pytest.mark.parametrize("kind", ["joints", "found"])
@pytest.mark.parametrize(("unit", "verdict"), [(1.0, "good"), (3.28, "doubtful"), (0.2, "doubtful")])
def test_a_person_of_no_person_s_size_is_told_with_the_unit_that_makes_one(
    kind: str, unit: float, verdict: str
) -> None:
    """Poses in feet that were taken for metres; joints in pixels are what they are."""
    rig = subjects_ring(4, size=512, focal=0.9, radius=3.5)
    seen, _ = filmed(at([np.zeros((20, 2))]), rig, noise=0.5)
    poses = rig.world_to_camera.copy()
    poses[:, :3, 3] *= unit
    rig = replace(rig, world_to_camera=poses)

    class Filmed:
        joint_set = "coco17"

        def read(self, view: int, number: int) -> np.ndarray:
            return np.asarray(seen[number][view])

    crops = np.tile([1.0, 0, 0], (4, 1))
    facts = frozenset({"joints2d"} if kind == "joints" else ())
    scope = scope_of(rig, rig, crops, facts)
    (f,) = of_stature(Footage(scope, crops, rig.size, [np.arange(20)] * 4, 25.0, {kind: Filmed()}))
    assert f.verdict == verdict
    assert f.value == pytest.approx(1.7 * unit, rel=0.15)
    if verdict != "good":
        factor = float(f.advice.partition("scale=")[2].partition(",")[0])
        assert factor * float(f.value or 0) == pytest.approx(1.7, rel=0.01)


def test_nobody_s_size_is_told_where_no_joints_are_or_the_subject_may_be_no_person() -> None:
    assert of_stature(footage()) == of_stature(footage("joints3d", found=Joints({}))) == []
