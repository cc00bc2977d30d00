"""The people of a capture: how many, in which cameras, and where each is seen."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import cv2
import numpy as np

from posegaussian.dags.inspection.figures import PairPicture, write_portraits
from posegaussian.dags.inspection.html_page import _figure, _people
from posegaussian.dags.inspection.portraits import portraits, told_by_place, who_is_who
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, measured
from posegaussian.stages.inspection.footage import Footage, scope_of
from posegaussian.stages.inspection.report import Report
from tests.stages.following.test_following import People, at, filmed
from tests.support.inspection_plans import planned
from tests.support.walking_skeleton import ring

RIG = ring(4, size=512, focal=0.9, radius=3.5)
RIG6 = ring(6, size=512, focal=0.9, radius=3.5)
FRAMES = 9


@dataclass
class Pictures:
    def read(self, view: int, numbers: list[int]) -> Any:
        for n in numbers:
            yield np.full((512, 512, 3), 20 * view + n, np.uint8)


@dataclass
class Found:
    people: People
    joint_set: str = "coco17"

    def read(self, view: int, number: int) -> np.ndarray:
        return np.array(self.people[number][view]).reshape(-1, 17, 3)


def footage(people: People) -> Footage:
    crops = np.tile([1.0, 0, 0], (len(RIG), 1))
    readers = {"found": Found(people), "pictures": Pictures()}
    return Footage(scope_of(RIG, RIG, crops, Facts()), crops, RIG.size, [np.arange(FRAMES)] * len(RIG), 25.0, readers)


def two_people() -> tuple[People, np.ndarray]:
    still = np.zeros((FRAMES, 2))
    return filmed(at([still, still + np.array([0.0, 0.9])]), RIG)


def test_everybody_is_there_once_with_the_cameras_that_show_them_and_a_picture(tmp_path: Path) -> None:
    people, order = two_people()
    people = [[p[order[f, v] == 0] if v == 3 else p for v, p in enumerate(views)] for f, views in enumerate(people)]
    found = portraits(footage(people))
    assert [p.name for p in found] == ["person1", "person2"]
    assert found[0].cameras == dict.fromkeys(RIG.names, 3)
    assert found[1].cameras == dict.fromkeys(RIG.names[:3], 3)
    assert [(p.frames, p.of_frames) for p in found] == [(3, 3)] * 2
    for p, which in zip(found, (0, 1), strict=True):
        at_it = order[p.number, p.view].tolist().index(which) if p.view < 3 else 0
        middle = people[p.number][p.view][at_it][:, :2].mean(axis=0)
        assert p.box[0] < middle[0] < p.box[2]
        assert p.box[1] < middle[1] < p.box[3]
    files = write_portraits(footage(people), found, tmp_path)
    text = _people(list(zip(found, files, strict=True)), tmp_path)
    for p, file in zip(found, files, strict=True):
        picture = cv2.imread(str(file))
        assert picture is not None
        assert int(picture[0, 0, 0]) == 20 * p.view + p.number
        assert f'src="{p.name}.png"' in text
        assert p.sentence in text


def test_pictures_are_found_whatever_a_camera_is_called(tmp_path: Path) -> None:
    """A browser reads what follows # or ? as no part of a file's name, and %20 as a space."""
    name = 'cam #1 50%20 "a"?.png'
    page = _figure(PairPicture((0, 1), tmp_path / name, "two"), [], RIG.names, tmp_path)
    (source,) = re.findall(r'src="([^"]*)"', page)
    assert unquote(urlsplit(source).path) == name
    person = portraits(footage(two_people()[0]))[0]
    (source,) = re.findall(r'src="([^"]*)"', _people([(person, tmp_path / name)], tmp_path))
    assert unquote(urlsplit(source).path) == name


def test_nobody_is_shown_where_nobody_looks_and_where_nobody_is() -> None:
    nobody = [[np.zeros((0, 17, 3))] * len(RIG) for _ in range(FRAMES)]
    assert portraits(footage(nobody)) == []
    blind = footage(nobody)
    blind.readers = {"pictures": Pictures()}  # type: ignore[misc]
    assert portraits(blind) == []
    assert _people([], Path()) == ""


def test_two_people_by_place_beside_pictures_of_one_are_explained() -> None:
    """Where a picture shows two there is nothing to explain, and of one person nothing to tell apart."""
    two = portraits(footage(two_people()[0]))
    alone, crowd = ([measured("people", (), share, "", 0.05, 1.0, "s", "do")] for share in (0.0, 0.5))
    first, *sentences = who_is_who(two, alone)
    assert first.startswith("people by place: 2, though no picture")
    assert who_is_who(two, crowd) == sentences == [p.sentence for p in two]
    assert who_is_who(two[:1], alone) == []
    assert "though no picture" in _people([(p, Path(f"{p.name}.png")) for p in two], Path(), who_is_who(two, alone))


def test_a_camera_that_is_not_believed_shows_nobody() -> None:
    found = portraits(footage(two_people()[0]).without([RIG.names[3]]))
    assert [p.cameras for p in found] == [dict.fromkeys(RIG.names[:3], 3)] * 2


def report_of(seen: Footage, *findings: Finding) -> Report:
    return Report(findings, (), (), None, planned(RIG6), seen)


def hugging() -> Footage:
    """Two people 0.4 m apart of whom every camera shows the nearer one alone."""
    still = np.zeros((FRAMES, 2))
    people, order = filmed(at([still, still + np.array([0.0, 0.4])]), RIG6)
    nearer = (RIG6.centres @ [0.3, 1.0, 0.0] > 0).astype(int)
    one = [[p[order[f, v] == nearer[v]] for v, p in enumerate(views)] for f, views in enumerate(people)]
    crops = np.tile([1.0, 0, 0], (len(RIG6), 1))
    readers = {"found": Found(one), "pictures": Pictures()}
    return Footage(
        scope_of(RIG6, RIG6, crops, Facts()), crops, RIG6.size, [np.arange(FRAMES)] * len(RIG6), 25.0, readers
    )


NONE_WITH_TWO = measured("people", (), 0.0, "of the pictures", 0.05, 1.0, "one person at most", "")


def test_two_who_touch_are_two_people_and_no_error_of_a_calibration_that_nothing_contradicts() -> None:
    seen = hugging()
    two = portraits(seen)
    assert [sorted(n for _, n in p.places.values()) for p in two] == [[3, 3]] * 2
    report = told_by_place(report_of(seen, NONE_WITH_TWO), two)
    (f,) = report.findings
    assert (f.measure, f.verdict, f.value) == ("people", FindingVerdict.DOUBTFUL, 2.0)
    assert "two people stand 0.4 m apart" in f.sentence
    assert "calibration" not in f.sentence
    assert "pose.subject: person2" in f.advice
    assert who_is_who(two, report.findings) == [p.sentence for p in two]
    off = measured("joint residual", ("cam0",), 9.0, "px", 2.0, 4.0, "off", "do")
    assert "calibration is off" in told_by_place(report_of(seen, NONE_WITH_TWO, off), two).findings[0].sentence


def test_a_place_that_two_cameras_agree_on_is_no_second_person_yet() -> None:
    """Two cameras that stand as high agree on places by chance."""
    seen = hugging().without([hugging().names[0]])
    two = portraits(seen)
    assert len(two) == 2
    report = report_of(seen, NONE_WITH_TWO)
    assert told_by_place(report, two) is report
    assert "calibration" not in who_is_who(two, report.findings)[0]
