"""`posegaussian inspect` on small made captures: every measure has number, verdict and advice, and a fault that was
made is found."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from html import escape
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from posegaussian.dags.cli.inspect import inspect
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.inspection.inspect import footage_of, planned_of, run_inspection
from posegaussian.dags.planning.context import Context
from posegaussian.stages.depth.params import resolve_method
from posegaussian.stages.inspection.finding import IMPACT, ORDER, Finding, FindingVerdict, worst_first
from posegaussian.stages.inspection.pairs import every_pair, of_pairs
from posegaussian.stages.inspection.report import Report
from posegaussian.stages.inspection.report import inspect as measure
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline, film

MEASURES = {
    "agreement",
    "picture size",
    "frames",
    "repeated pictures",
    "principal point",
    "focal lengths",
    "lens distortion",
    "lens model",
    "aim",
    "epipolar distance",
    "joint residual",
    "calibration by joints",
    "mask agreement",
    "mask at the rim",
    "joints on masks",
    "time offset",
    "exposure",
    "clipped white",
    "focus",
    "blur against others",
    "people",
    "stature",
    "matte",
    "cameras",
    "partners",
    "neighbours",
    "rectification",
}


def context_of(folder: Path, archive: Path, *settings: str) -> Context:
    pipeline = Pipeline(archive, folder, ["depth.method=auto", *settings], held_out="[]")
    pipeline.register()
    return Context(pipeline.session.archive.sequence(NAME), pipeline.configuration.for_sequence(NAME), ())


def report_of(context: Context) -> Report:
    return measure(*footage_of(context), planned_of(context))


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    film(folder, views=5, size=96, frames=24, held_out=0, depth=False)
    return folder


@pytest.fixture
def spoilt(capture: Path, tmp_path: Path) -> Callable[[Callable[[Path], None]], Report]:
    """The report on a copy of the capture to which something was done."""
    import shutil

    def of(spoil: Callable[[Path], None]) -> Report:
        copy = tmp_path / "copy"
        shutil.copytree(capture, copy)
        spoil(copy)
        return report_of(context_of(copy, tmp_path / "archive"))

    return of


def found(report: Report, what: str, camera: str) -> Finding:
    return next(f for f in report.findings if f.measure == what and f.cameras == (camera,))


class Parts(HTMLParser):
    """What a page refers to, and how many rows its table has."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures: list[str] = []
        self.rows = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.rows += tag == "tr"
        self.pictures += [v or "" for k, v in attrs if k in ("src", "href")]


def test_page_pictures_and_table_of_a_whole_capture(capture: Path, tmp_path: Path) -> None:
    context = context_of(capture, tmp_path / "archive")
    console = Console(record=True, width=120, file=(tmp_path / "log").open("w"))
    status = run_inspection(context, console, tmp_path / "page")
    report = report_of(context)
    assert {f.measure for f in report.findings} == MEASURES
    for f in report.findings:
        assert f.sentence
        assert (f.value is None) == (f.verdict is FindingVerdict.UNKNOWN)
        assert f.advice or f.verdict not in (FindingVerdict.BAD, FindingVerdict.DOUBTFUL)
        assert f.value is None or np.isfinite(f.value)
    assert status == (report.verdict is FindingVerdict.BAD)
    page = (tmp_path / "page" / "index.html").read_text()
    parts = Parts()
    parts.feed(page)
    assert parts.rows == len(report.findings) + 1
    assert len(parts.pictures) == 11
    assert all((tmp_path / "page" / p).is_file() for p in parts.pictures)
    assert not re.search(r"https?:", page)
    assert all(escape(line) in page for line in report.outlook)
    assert "nothing to do" not in page, "five cameras around are 72 degrees apart"
    assert page.index(report.sentence) < page.index("Pairs of cameras") < page.index("All numbers")
    text = console.export_text()
    assert report.sentence in " ".join(text.split())
    assert all(m.split()[0] in text for m in MEASURES)
    assert all(" ".join(line.split()) in " ".join(text.split()) for line in report.outlook)
    assert report.verdict is FindingVerdict.DOUBTFUL
    assert any("expected: fair, all around" in line for line in report.outlook)


def test_exact_joints_masks_and_cameras_are_good(capture: Path, tmp_path: Path) -> None:
    """Features and edges of a plain body of 96 px say little, and five cameras around stand 72 degrees apart; all
    else is exact."""
    report = report_of(context_of(capture, tmp_path / "archive"))
    for f in report.findings:
        if f.measure not in (
            "epipolar distance",
            "focus",
            "blur against others",
            "exposure",
            "people",
            "partners",
            "neighbours",
        ):
            assert f.verdict in (FindingVerdict.GOOD, FindingVerdict.NOTE), f


def turn_cam01(folder: Path, *degrees: float, behind: float = 0.0) -> None:
    """Write a camera of a capture down turned, by a rotation vector in its axes, and so many metres behind."""
    cameras = json.loads((folder / "cameras.json").read_text())
    one = next(c for c in cameras["cameras"] if c["name"] == "cam01")
    turn = cv2.Rodrigues(np.radians(np.array(degrees)))[0]
    one["R"], one["t"] = (turn @ np.array(one["R"])).tolist(), (turn @ np.array(one["t"]) + [0, 0, behind]).tolist()
    (folder / "cameras.json").write_text(json.dumps(cameras))


def test_a_camera_whose_pose_is_wrong_is_found(spoilt: Callable[[Callable[[Path], None]], Report]) -> None:
    """By two degrees about the axes across, some 4 px of 96, and in a wrong place, which no turn mends. Without a pair
    on the clean side no pair of the others is accused as much. No masks tell how it stands."""

    def turn(folder: Path) -> None:
        shutil.rmtree(folder / "masks")
        turn_cam01(folder, 1.5, 1.5, 0.0, behind=0.5)

    report = spoilt(turn)
    assert report.verdict is FindingVerdict.BAD
    accused = [
        f.cameras for f in report.findings if f.measure == "calibration by joints" and f.verdict is FindingVerdict.BAD
    ]
    assert len(accused) >= 2
    assert all("cam01" in cameras for cameras in accused)


@pytest.mark.parametrize("by", ["silhouette", "joints"])
def test_a_camera_that_is_turned_back_is_told_of_and_all_else_is_measured_as_it_stands(
    spoilt: Callable[[Callable[[Path], None]], Report], by: str
) -> None:
    def turn(folder: Path) -> None:
        turn_cam01(folder, 1.5, 1.5, 0.0)
        if by == "joints":
            shutil.rmtree(folder / "masks")

    report = spoilt(turn)
    told = [f for f in report.findings if f.measure == "agreement" and f.verdict is FindingVerdict.DOUBTFUL]
    assert [f.cameras for f in told] == [("cam01",)]
    assert "turned by 2." in told[0].sentence
    assert f"its {by} lie" in told[0].sentence
    assert "run turns cam01: see agreement; views.trust overrules it" in report.outlook
    joints = [f.verdict for f in report.findings if f.measure == "calibration by joints"]
    assert joints
    assert FindingVerdict.BAD not in joints


def test_a_camera_of_another_recording_is_found(spoilt: Callable[[Callable[[Path], None]], Report]) -> None:
    """Its pose is turned so far that nobody stands where it says."""

    report = spoilt(lambda folder: turn_cam01(folder, 20.0, 15.0, 0.0))
    assert report.verdict is FindingVerdict.BAD
    assert found(report, "joint residual", "cam01").verdict is FindingVerdict.BAD


def test_one_frame_is_judged_as_many_are(tmp_path: Path) -> None:
    """Of one frame, too: exact joints are good in every camera, a camera of another recording is bad, and where
    nobody but one camera shows anyone nothing is said against it."""
    from posegaussian.stages.inspection.subject import of_joints

    film(tmp_path / "capture", views=5, size=96, frames=1, held_out=0, depth=False)
    exact = of_joints(footage_of(context_of(tmp_path / "capture", tmp_path / "exact"))[0])
    assert [f.verdict for f in exact] == 5 * [FindingVerdict.GOOD]
    cameras = json.loads((tmp_path / "capture" / "cameras.json").read_text())
    one = next(c for c in cameras["cameras"] if c["name"] == "cam01")
    turn_by = cv2.Rodrigues(np.radians([20.0, 15.0, 0.0]))[0]
    one["R"], one["t"] = (turn_by @ np.array(one["R"])).tolist(), (turn_by @ np.array(one["t"])).tolist()
    (tmp_path / "capture" / "cameras.json").write_text(json.dumps(cameras))
    turned = of_joints(footage_of(context_of(tmp_path / "capture", tmp_path / "turned"))[0])
    assert [f.cameras for f in turned if f.verdict is FindingVerdict.BAD] == [("cam01",)]
    for file in (tmp_path / "capture" / "joints").glob("*.json"):
        if file.stem != "cam02":
            file.write_text(json.dumps(json.loads(file.read_text()) | {"annotations": []}))
    alone = of_joints(footage_of(context_of(tmp_path / "capture", tmp_path / "alone"))[0])
    assert {f.verdict for f in alone} == {FindingVerdict.UNKNOWN}


def test_a_late_camera_is_found_and_the_setting_that_is_advised_mends_it(
    spoilt: Callable[[Callable[[Path], None]], Report], tmp_path: Path
) -> None:
    def late(folder: Path) -> None:
        for kind in ("images", "masks"):
            for file in sorted((folder / kind / "cam02").iterdir(), reverse=True):
                file.rename(file.with_name(f"{int(file.stem) + 2:06d}{file.suffix}"))
        joints = folder / "joints" / "cam02.json"
        joints.write_text(re.sub(r"(\d{6})\.png", lambda m: f"{int(m[1]) + 2:06d}.png", joints.read_text()))

    report = spoilt(late)
    one = found(report, "time offset", "cam02")
    assert one.verdict is FindingVerdict.BAD
    advised = re.search(r"time_offset: (\{.*?\})", one.advice)
    assert advised
    mended = report_of(context_of(tmp_path / "copy", tmp_path / "archive", f"frames.time_offset={advised[1]}"))
    assert found(mended, "time offset", "cam02").verdict is FindingVerdict.GOOD


def repainted(folder: Path, cameras: str, paint: Callable[[np.ndarray], np.ndarray]) -> None:
    """Masks of the cameras that a pattern names, changed."""
    for file in (folder / "masks").glob(f"{cameras}/*"):
        cv2.imwrite(str(file), paint(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)))


def bad_cameras(report: Report, measure_name: str) -> set[str]:
    return {f.cameras[0] for f in report.findings if f.measure == measure_name and f.verdict is FindingVerdict.BAD}


@pytest.mark.parametrize(
    ("cameras", "paint", "by_rim", "by_joints"),
    [
        ("*", lambda m: 255 - m, 5, 5),
        ("cam02", lambda m: 0 * m, 0, 1),
        ("cam02", lambda m: 0 * m + 255, 1, 0),
        ("cam02", lambda m: np.roll(m, 40, axis=1), 0, 1),
        ("*", lambda m: cv2.erode(m, np.ones((2, 2))), 0, 0),
    ],
    ids=["inverted", "empty", "whole", "elsewhere", "a little small"],
)
def test_masks_that_are_not_the_subjects_are_found(
    spoilt: Callable[[Callable[[Path], None]], Report],
    cameras: str,
    paint: Callable[[np.ndarray], np.ndarray],
    by_rim: int,
    by_joints: int,
) -> None:
    """In the cameras that have them, and in no other."""
    report = spoilt(lambda folder: repainted(folder, cameras, paint))
    for measure_name, count in (("mask at the rim", by_rim), ("joints on masks", by_joints)):
        bad = bad_cameras(report, measure_name)
        assert len(bad) == count, (measure_name, bad)
        assert cameras == "*" or bad <= {cameras}


def test_one_inverted_mask_is_told_before_those_that_it_contradicts(
    spoilt: Callable[[Callable[[Path], None]], Report],
) -> None:
    """And nobody is told to look for a fault in the masks of the others."""
    report = spoilt(lambda folder: repainted(folder, "cam02", lambda m: 255 - m))
    innocent = [f for f in report.findings if f.measure == "mask agreement" and f.cameras != ("cam02",) and f.advice]
    assert {f.advice for f in innocent} == {"mend the masks of cam02, which it is compared with, and inspect again"}
    assert [f.measure for f in worst_first(report.findings)][:2] == ["mask at the rim", "joints on masks"]
    assert "cam02" in report.to_do[0][1]
    assert report.sentence.startswith("This capture is bad (mask at the rim, joints on masks, mask agreement")


def test_without_joints_and_masks_it_says_what_cannot_be_measured(
    spoilt: Callable[[Callable[[Path], None]], Report],
) -> None:
    import shutil

    def strip(folder: Path) -> None:
        shutil.rmtree(folder / "joints")
        shutil.rmtree(folder / "masks")

    told = " ".join(spoilt(strip).unmeasured)
    for measure_name in ("joint residual", "time offset", "mask agreement"):
        assert measure_name in told
    assert "no 2D joints" in told


def test_one_camera_and_pictures_of_different_sizes(tmp_path: Path) -> None:
    film(tmp_path / "one", views=1, size=64, frames=2, held_out=0, depth=False)
    context = context_of(tmp_path / "one", tmp_path / "first")
    assert run_inspection(context, Console(quiet=True), tmp_path / "page") == 0
    assert (tmp_path / "page" / "cam00.png").is_file()
    film(tmp_path / "two", views=3, size=64, frames=4, held_out=0, depth=False, masks=False, joints=False)
    cameras = json.loads((tmp_path / "two" / "cameras.json").read_text())
    small = next(c for c in cameras["cameras"] if c["name"] == "cam01")
    k = np.array(small["K"])
    k[:2] /= 2
    small["K"], small["width"], small["height"] = k.tolist(), 32, 32
    (tmp_path / "two" / "cameras.json").write_text(json.dumps(cameras))
    for file in (tmp_path / "two" / "images" / "cam01").iterdir():
        cv2.imwrite(str(file), cv2.resize(cv2.imread(str(file)), (32, 32), interpolation=cv2.INTER_AREA))
    mixed = context_of(tmp_path / "two", tmp_path / "second")
    assert run_inspection(mixed, Console(quiet=True), tmp_path / "mixed") in (0, 1)
    assert len(list((tmp_path / "mixed").glob("*.png"))) == 3


def test_a_crop_that_was_forgotten_is_told_with_a_suggestion(capture: Path, tmp_path: Path) -> None:
    """The import refuses it; a setting that was taken away afterwards is found here."""
    import dataclasses

    context = context_of(capture, tmp_path / "archive")
    rig = context.capture.rig
    context.__dict__["capture"] = dataclasses.replace(
        context.capture, rig=dataclasses.replace(rig, size=rig.size + [[8, 8]] * len(rig))
    )
    sizes = footage_of(context)[1]
    assert all(f.verdict is FindingVerdict.BAD and "scale: 1.08333" in f.advice for f in sizes)


def test_what_is_predicted_is_what_the_plan_says(tmp_path: Path) -> None:
    """Pairs, mattes and joints by the plan's own words;
    of eight cameras one is held out, so its neighbours stand 90 degrees apart."""
    film(tmp_path / "capture", views=7, size=64, frames=3, held_out=1, depth=False, masks=False)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture")
    pipeline.register()
    context, plan = pipeline.context(), planned_of(pipeline.context())
    refused = [n for n in pipeline.plan().notes if n.startswith("depth does not match")]
    assert sum(int(n.split()[4]) for n in refused) == len(plan.refused) > 0
    assert [plan.matte] == [
        c.resolve(context.settings.frames, context.capture_facts) for c in stage_named("frames").choices
    ]
    assert plan.depth.method == resolve_method(context.settings.depth, context.facts).name
    assert plan.sources == context.views.sources
    told = measure(*footage_of(context), plan).outlook
    assert any(f"of {len(plan.source_reports)} pairs" in line for line in told)
    assert any(line.startswith(f"mattes: frames.matte: {plan.matte[0]}") for line in told)


def test_the_advice_is_ordered_by_use_within_its_verdict(spoilt: Callable[[Callable[[Path], None]], Report]) -> None:
    """What makes other measures wrong comes before what it makes wrong; nothing bad comes after what is doubtful."""
    import shutil

    report = spoilt(lambda folder: shutil.rmtree(folder / "masks"))
    order = [next(f.measure for f in report.findings if f.advice == advice) for _, _, advice in report.to_do]
    verdicts = [verdict for verdict, _, _ in report.to_do]
    assert verdicts == sorted(verdicts, key=ORDER.index)
    for verdict in set(verdicts):
        places = [IMPACT.index(m) for m, v in zip(order, verdicts, strict=True) if v is verdict]
        assert places == sorted(places)
    assert {f.measure for f in report.findings if f.advice} <= set(IMPACT)


@pytest.mark.captures
@pytest.mark.parametrize(
    ("layout", "name", "matched", "refused"),
    [
        ("pose2sim", "balance", {("cam01", "cam02"), ("cam01", "cam04"), ("cam03", "cam04")}, 3),
        (
            "caliscope",
            "desk",
            set(combinations(("cam_0", "cam_1", "cam_2", "cam_3"), 2)),  # of what cam_3 shows only cam_2 shows most
            0,
        ),
    ],
)
def test_pairs_of_real_captures(
    layout: str, name: str, matched: set[tuple[str, str]], refused: int, captures: Path, tmp_path: Path
) -> None:
    crop = "frames.crop={cam01: {scale: 1.00741, offset: [0, -7.11]}, cam02: {scale: 1.00741, offset: [0, -7.11]}}"
    configuration = load_configuration(None, [crop] if name == "balance" else [], folder=tmp_path)
    settings = configuration.for_sequence(name)
    archive = Archive.open(str(tmp_path / "archive"), create=True)
    register(archive, name, find_capture(layout, captures / "captures" / name, [], settings), settings)
    plan = planned_of(Context(archive.sequence(name), settings, ()))
    assert {(plan.rig.names[a], plan.rig.names[b]) for a, b in plan.matched} == matched
    assert len(plan.refused) == refused
    worst = {f.measure: f.verdict for f in of_pairs(plan, every_pair(plan))}
    assert FindingVerdict.BAD not in worst.values(), "the sweep, which auto comes to, asks for no rows in common"
    assert name == "desk" or worst["neighbours"] is FindingVerdict.DOUBTFUL


def test_the_command_has_its_help() -> None:
    assert "Exit status 1" in (inspect.__doc__ or "")


def test_frames_that_are_not_worked_on_do_not_count_and_the_advice_says_which_to_take(
    spoilt: Callable[[Callable[[Path], None]], Report], tmp_path: Path
) -> None:
    """One camera stopped after half of the frames: told of the whole capture, with a setting that mends it."""

    def shorten(folder: Path) -> None:
        for kind in ("images", "masks"):
            for file in sorted((folder / kind / "cam03").iterdir())[12:]:
                file.unlink()

    whole = found(spoilt(shorten), "frames", "cam03")
    assert whole.verdict is FindingVerdict.BAD
    advised = re.search(r"frames\.range=\d+:\d+$", whole.advice)
    assert advised
    assert advised[0] == "frames.range=0:12"
    cut = report_of(context_of(tmp_path / "copy", tmp_path / "archive", advised[0]))
    assert {f.verdict for f in cut.findings if f.measure == "frames"} == {FindingVerdict.GOOD}
    assert len(cut.footage.common) == 12
