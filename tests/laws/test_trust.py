"""A wrong camera ruins nothing: it is found among seven that are right, named, and turned back or left out; right ones
never are."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.dags.diagnostics.effects_table import effects_reasons
from posegaussian.dags.inspection.inspect import footage_of, planned_of
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import Notice, TasksChanged
from posegaussian.stages.inspection.finding import FindingVerdict
from posegaussian.stages.inspection.trust import camera_verdicts, of_trust
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import Pipeline, film

WRONG = "cam02"
SETTINGS = ["views.trust=auto", "depth.method=hull", "metrics.measures=[psnr]", "frames.range=0:1"]
Spoil = Callable[[dict[str, Any]], None]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trust") / "capture"
    film(folder, views=8, size=128, frames=1, depth=False)
    return folder


def turned(*degrees: float) -> Spoil:
    """By a rotation vector in camera axes."""
    turn = cv2.Rodrigues(np.radians(np.array(degrees, dtype=np.float64)))[0]

    def spoil(camera: dict[str, Any]) -> None:
        camera["R"], camera["t"] = (turn @ np.array(camera["R"])).tolist(), (turn @ np.array(camera["t"])).tolist()

    return spoil


def shifted(*metres: float) -> Spoil:
    def spoil(camera: dict[str, Any]) -> None:
        camera["t"] = (np.array(camera["t"]) + metres).tolist()

    return spoil


def focal(factor: float) -> Spoil:
    def spoil(camera: dict[str, Any]) -> None:
        for axis in range(2):
            camera["K"][axis][axis] *= factor

    return spoil


def spoilt(capture: Path, folder: Path, how: Spoil | None, wrong: tuple[str, ...] = (WRONG,)) -> Pipeline:
    """An archive of the capture with some cameras written down wrongly."""
    copy = folder / "capture"
    shutil.copytree(capture, copy)
    written = json.loads((copy / "cameras.json").read_text())
    for camera in written["cameras"]:
        if how is not None and camera["name"] in wrong:
            how(camera)
    (copy / "cameras.json").write_text(json.dumps(written))
    pipeline = Pipeline(folder / "archive", copy, SETTINGS)
    pipeline.register()
    return pipeline


def by_inspection(context: Context, verdict: FindingVerdict) -> set[str]:
    found = of_trust(camera_verdicts(footage_of(context)[0], planned_of(context)))
    return {f.cameras[0] for f in found if f.verdict is verdict}


def left_out_by_inspection(context: Context) -> set[str]:
    return by_inspection(context, FindingVerdict.LEFT_OUT)


def turned_by_inspection(context: Context) -> set[str]:
    return by_inspection(context, FindingVerdict.DOUBTFUL)


@pytest.mark.parametrize("how", [shifted(0, 0, 0.6), focal(1.15)], ids=["moved away", "focal length"])
def test_a_wrong_camera_of_eight_is_found_and_no_other_is_accused(capture: Path, tmp_path: Path, how: Spoil) -> None:
    context = spoilt(capture, tmp_path, how).context()
    assert left_out_by_inspection(context) == {WRONG}
    assert not turned_by_inspection(context)


@pytest.mark.parametrize(
    "how",
    [turned(2, 2, 0), turned(0, 0, 5), shifted(0, 0.1, 0)],
    ids=["turned", "rolled", "raised"],
)
def test_a_camera_of_eight_that_a_turn_mends_is_turned_and_no_other_is(
    capture: Path, tmp_path: Path, how: Spoil
) -> None:
    context = spoilt(capture, tmp_path, how).context()
    assert turned_by_inspection(context) == {WRONG}
    assert not left_out_by_inspection(context)


def test_without_masks_joints_tell_who_is_turned(capture: Path, tmp_path: Path) -> None:
    """Two of eight by 2 degrees, along the lines of the others; of the exact joints that came with the capture to a
    hundredth of a degree, the same in a run as by inspection."""
    two = ("cam01", "cam04")
    p = spoilt(capture, tmp_path, turned(0, 2, 0), two)
    shutil.rmtree(p.folder / "masks")
    p = p.with_settings("depth.method=sgbm")
    p.register()
    assert turned_by_inspection(p.context()) == set(two)
    assert left_out_by_inspection(p.context()) == set()
    p.run(selection=Selection(only=frozenset({"survey"})))
    verdicts = p.plan().context.cameras
    assert {name for name, verdict in verdicts.items() if verdict.turn.any()} == set(two)
    for name in two:
        assert np.degrees(verdicts[name].turn) == pytest.approx([0, -2, 0], abs=0.01)
        assert "its joints lie" in verdicts[name].sentence
    assert turned_by_inspection(p.with_settings("detection.estimator=none").context()) == set(), "a run has no joints"


@pytest.mark.parametrize("how", [None, turned(0.05, 0.05, 0.05), focal(1.003)], ids=["exact", "0.2 px", "0.3 %"])
def test_cameras_that_are_right_or_nearly_so_are_believed(capture: Path, tmp_path: Path, how: Spoil | None) -> None:
    context = spoilt(capture, tmp_path, how).context()
    assert left_out_by_inspection(context) == set()
    assert turned_by_inspection(context) == set()


def test_of_two_parties_the_larger_one_is_believed(capture: Path, tmp_path: Path) -> None:
    three = ("cam01", "cam02", "cam03")
    assert left_out_by_inspection(spoilt(capture, tmp_path, turned(3, 0, 0), three).context()) == set(three)


def psnr(pipeline: Pipeline) -> float:
    context = pipeline.plan().context
    (path,) = context.paths
    rows = Results(context).table("metrics/{path}", path)
    return float(np.mean([r["value"] for r in rows if r["measure"] == "psnr" and r["region"] == "box"]))


def test_a_run_turns_cameras_back_says_so_and_draws_them_as_they_stand(capture: Path, tmp_path: Path) -> None:
    """Two that are turned by 2 degrees, 10 px of 128, which no line tells of a level ring: as good as cameras that are
    right up to 0.3 dB, for what masks of 128 px tell of a turn; as they are written down pictures lose more than 3."""
    two = ("cam01", "cam04")
    p = spoilt(capture, tmp_path, turned(0, 2, 0), two)
    told = [e.sentence for e in p.run() if isinstance(e, Notice)]
    assert len(told) == 2
    for name, sentence in zip(two, told, strict=True):
        assert f"camera {name} believed turned by" in sentence
    plan = p.plan()
    assert plan.all_fresh, "the decision is the same when it is taken again"
    names = plan.context.views.names
    assert set(two) <= {names[v] for v in plan.context.views.sources}
    right = spoilt(capture, tmp_path / "right", None)
    true = right.plan().context.rig.world_to_camera
    for v in (names.index(n) for n in two):
        off = plan.context.rig.rotations[v] @ true[v, :3, :3].T
        assert np.degrees(np.arccos((np.trace(off) - 1) / 2)) < 0.5, "of 2; a roll is told least"
    assert any(two[0] in line for line in effects_reasons(plan, every=False))
    assert any(two[0] in note for note in plan.notes)
    right.run()
    turned_back, without = psnr(p), psnr(right)
    assert turned_back > without - 0.3
    everyone = p.with_settings("views.trust=all")
    everyone.run()
    assert not everyone.plan().context.cameras_undecided
    assert psnr(everyone) < without - 3


def test_a_run_leaves_it_out_says_so_and_loses_nothing_by_it(capture: Path, tmp_path: Path) -> None:
    """As good as without it, up to what the other cameras' survey sees differently: nothing here."""
    p = spoilt(capture, tmp_path, focal(1.15))
    assert p.plan().context.cameras_undecided
    told = [e.sentence for e in p.run() if isinstance(e, Notice)]
    assert len(told) == 1
    assert WRONG in told[0]
    assert "contradicts" in told[0]
    plan = p.plan()
    assert plan.all_fresh, "the decision is the same when it is taken again"
    names = plan.context.views.names
    assert WRONG not in {names[v] for v in plan.context.views.sources}
    assert names.index(WRONG) in plan.context.active_views, "its pictures stay"
    assert any(WRONG in line for line in effects_reasons(plan, every=False))
    assert any(WRONG in note for note in plan.notes)
    believed = psnr(p)
    others = [n for n in names if n.startswith("cam") and n != WRONG]
    without = p.with_settings(f"views.sources={json.dumps(others)}")
    without.run()
    assert believed == pytest.approx(psnr(without), abs=0.05)
    everyone = p.with_settings("views.trust=all")
    everyone.run()
    assert psnr(everyone) > believed - 0.1, "believed, its silhouette alone carves nothing"


def test_the_default_path_leads_along_believed_cameras(capture: Path, tmp_path: Path) -> None:
    """It was planned along all of them: the run changes its tasks, and afterwards everything is fresh."""
    p = spoilt(capture, tmp_path, focal(1.15)).with_settings("views.held_out=[]", "views.sources=null")
    before = set(p.plan().context.paths)
    events = p.run()
    (changed,) = (e for e in events if isinstance(e, TasksChanged))
    assert {t.path for t in changed.gone} == before
    after = p.plan()
    assert after.all_fresh
    assert set(after.context.paths) == {t.path for t in changed.come} != before


def test_the_setting_overrules_and_unknown_names_are_refused(capture: Path, tmp_path: Path) -> None:
    p = spoilt(capture, tmp_path, focal(1.15))
    named = p.with_settings(f"views.trust=[{WRONG}]")
    named.run()
    verdict = named.plan().context.cameras[WRONG]
    assert (verdict.state, verdict.forced) == ("believed", True)
    assert "contradicts" in verdict.sentence, "what was measured is told all the same"
    assert not p.with_settings("views.trust=all").plan().context.cameras_undecided
    with pytest.raises(ConfigError, match=r"views\.trust.*no camera 'nobody'"):
        p.with_settings("views.trust=[nobody]").context().views  # noqa: B018
