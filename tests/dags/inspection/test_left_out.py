"""A camera that a run leaves out by itself is told of, and moves neither the verdict nor what is said of the others."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.dags.inspection.inspect import footage_of
from posegaussian.stages.inspection.finding import Finding, FindingVerdict
from posegaussian.stages.inspection.report import Report
from posegaussian.stages.inspection.subject import of_time
from tests.dags.inspection.test_inspecting import context_of, report_of
from tests.support.pipeline import film

WRONG = "cam01"


def turned(folder: Path, views: int) -> None:
    """A person filmed all around, where the pose of one camera is 25 degrees off."""
    film(folder, views=views, size=96, frames=3, held_out=0, depth=False)
    cameras = json.loads((folder / "cameras.json").read_text())
    one = next(c for c in cameras["cameras"] if c["name"] == WRONG)
    turn = cv2.Rodrigues(np.radians([20.0, 15.0, 0.0]))[0]
    one["R"], one["t"] = (turn @ np.array(one["R"])).tolist(), (turn @ np.array(one["t"])).tolist()
    (folder / "cameras.json").write_text(json.dumps(cameras))


@pytest.fixture(scope="module")
def eight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("eight")
    turned(folder, 8)
    return folder


@pytest.fixture(scope="module")
def report(eight: Path, tmp_path_factory: pytest.TempPathFactory) -> Report:
    return report_of(context_of(eight, tmp_path_factory.mktemp("archive"), "views.trust=auto"))


def of_others(report: Report) -> dict[tuple[str, tuple[str, ...]], tuple[str, FindingVerdict]]:
    """Findings on believed cameras; of agreement, which is measured to tell whom to believe, none."""
    kept = [f for f in report.findings if WRONG not in f.cameras and f.measure != "agreement"]
    return {(f.measure, f.cameras): (f.number, f.verdict) for f in kept}


def test_others_are_measured_as_if_it_had_been_left_out_by_hand(report: Report, eight: Path, tmp_path: Path) -> None:
    others = [f"cam{i:02d}" for i in range(8) if f"cam{i:02d}" != WRONG]
    by_hand = report_of(context_of(eight, tmp_path / "archive", f"views.sources={json.dumps(others)}"))
    assert of_others(report) == of_others(by_hand)
    assert report.verdict is by_hand.verdict


def test_it_is_told_of_and_does_not_count(report: Report) -> None:
    own: list[Finding] = [f for f in report.findings if WRONG in f.cameras]
    assert {f.measure for f in own if f.verdict is FindingVerdict.LEFT_OUT} >= {"agreement", "mask agreement"}
    assert not {f.verdict for f in own} & {FindingVerdict.BAD, FindingVerdict.DOUBTFUL}
    assert report.verdict is FindingVerdict.GOOD
    assert f"leaves out {WRONG}" in report.sentence
    told = [line for line in report.outlook if WRONG in line]
    assert told[0].startswith(f"run leaves out {WRONG}")
    assert not any(line.startswith("expected: ") for line in told)
    advised = [advice for verdict, _, advice in report.to_do if verdict is FindingVerdict.LEFT_OUT]
    assert any("a run leaves it out" in advice for advice in advised)
    verdicts = [verdict for verdict, _, _ in report.to_do]
    assert verdicts == sorted(verdicts, key=list(FindingVerdict).index)


def test_the_capture_is_bad_where_those_that_are_left_do_not_suffice(tmp_path: Path) -> None:
    """Of three cameras around two are left, too far apart to be matched."""
    turned(tmp_path / "three", 3)
    report = report_of(context_of(tmp_path / "three", tmp_path / "archive", "views.trust=auto"))
    assert report.footage.left_out == (1,)
    assert report.verdict is FindingVerdict.BAD
    assert any("not fit to be shown" in line for line in report.outlook)


def test_the_offset_of_a_late_camera_is_told_where_it_is_not_believed(tmp_path: Path) -> None:
    """By three frames of a kick; the others are in step to the number."""
    film(tmp_path / "late", views=5, size=96, frames=24, held_out=0, depth=False)
    for kind in ("images", "masks"):
        for file in sorted((tmp_path / "late" / kind / WRONG).iterdir(), reverse=True):
            file.rename(file.with_name(f"{int(file.stem) + 3:06d}{file.suffix}"))
    joints = tmp_path / "late" / "joints" / f"{WRONG}.json"
    joints.write_text(re.sub(r"(\d{6})\.png", lambda m: f"{int(m[1]) + 3:06d}.png", joints.read_text()))
    footage, _ = footage_of(context_of(tmp_path / "late", tmp_path / "archive"))
    others = json.dumps([name for name in footage.names if name != WRONG])
    alone, _ = footage_of(context_of(tmp_path / "late", tmp_path / "archive", f"views.sources={others}"))
    assert np.array_equal(footage.without([WRONG]).joints[1], alone.joints[1])
    assert not np.array_equal(footage.joints[1][: len(alone.joints[1])], alone.joints[1]), (
        "it is late enough to be seen"
    )
    offsets = {f.cameras[0]: f for f in of_time(footage.without([WRONG]))[0]}
    assert offsets[WRONG].verdict is FindingVerdict.BAD
    assert re.search(r"time_offset: \{cam01: (2\.9|3\.0)", offsets[WRONG].advice)
    assert {f.verdict for name, f in offsets.items() if name != WRONG} == {FindingVerdict.GOOD}
