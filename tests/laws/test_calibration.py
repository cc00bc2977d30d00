"""Cameras that are a little off are turned back, by what the capture itself shows; right ones, and wrong evidence, turn
nobody."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import EffectsDecided, TaskDone
from posegaussian.stages.contract.declaration import Decision, Evidence
from posegaussian.stages.contract.judged import CALIBRATION, NONE, TURNS
from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.imaging.calibration import CALIBRATION_CORRECTION, SMALLEST
from posegaussian.stages.imaging.small_turns import LINKS, Links
from posegaussian.storage.model.cameras import Rig, rigid, rotation_matrix
from tests.support.pipeline import Pipeline, film

SETTINGS = ["effects.calibration_correction=auto", "metrics.measures=[psnr]", "frames.range=0:2", "judge.views=4"]
OFF = 1.0
"""Px, standard deviation an axis, by which turned cameras move their pictures."""
SIZE = 128
MADE = Selection(only=frozenset({"survey", "judge", "frames"}))


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("calibration") / "capture"
    film(folder, views=8, size=SIZE, frames=2)
    return folder


def written(capture: Path, folder: Path, pixels: float, *settings: str) -> Pipeline:
    """An archive of the capture, whose source cameras are written down turned; the held-out one is right."""
    copy, random = folder / "capture", np.random.default_rng(3)
    shutil.copytree(capture, copy)
    cameras = json.loads((copy / "cameras.json").read_text())
    for camera in cameras["cameras"]:
        turn = rotation_matrix(random.normal(size=3) * pixels / camera["K"][0][0])
        if camera["name"] != "mid00":
            camera["R"], camera["t"] = (turn @ np.array(camera["R"])).tolist(), (turn @ np.array(camera["t"])).tolist()
    (copy / "cameras.json").write_text(json.dumps(cameras))
    pipeline = Pipeline(folder / "archive", copy, [*SETTINGS, *settings])
    pipeline.register()
    return pipeline


def missed(true: Rig, rig: Rig, views: list[int]) -> float:
    """Px by which pairs of a rig miss points about the middle that true cameras see, root mean square."""
    points, off = _middle(true) + np.random.default_rng(2).uniform(-0.4, 0.4, (40, 3)), []
    for a, b in combinations(views, 2):
        x, y = (project(points, true.intrinsics[v], true.world_to_camera[v])[0] for v in (a, b))
        off.append(signed_epipolar_distance(fundamental(rig, a, b), x, y))
    return float(np.sqrt(np.mean(np.square(off))))


def psnr(p: Pipeline) -> float:
    context = p.plan().context
    (path,) = context.paths
    rows = Results(context).table("metrics/{path}", path)
    return float(np.mean([r["value"] for r in rows if r["measure"] == "psnr" and r["region"] == "box"]))


@pytest.fixture(scope="module")
def corrected(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Pipeline, list]:
    p = written(capture, tmp_path_factory.mktemp("corrected"), OFF)
    return p, p.run()


def test_turned_cameras_are_turned_back(capture: Path, corrected: tuple[Pipeline, list]) -> None:
    """Pairs miss what both see by a third of what they did, and less, as far as links tell and in truth; the cameras
    stay in their places, and the one kept aside stays as it is."""
    p, events = corrected
    (told,) = [s for e in events if isinstance(e, EffectsDecided) for s in e.sentences if "calibration" in s]
    assert told.startswith("calibration_correction on (auto): outermost points of outlines")
    assert "left-out source views" in told
    context = p.plan().context
    sources = list(context.views.sources)
    links = Links.of(context.noted[LINKS][:, sources])
    before, after = (links.medians(r.subset(sources))["outlines"] for r in (context.calibrated_rig, context.rig))
    assert after < before / 3
    assert np.allclose(context.rig.centres, context.calibrated_rig.centres)
    held_out = context.rig.index("mid00")
    assert np.array_equal(context.rig.world_to_camera[held_out], context.calibrated_rig.world_to_camera[held_out])
    poses = context.calibrated_rig.world_to_camera.copy()
    for v, camera in enumerate(json.loads((capture / "cameras.json").read_text())["cameras"]):
        poses[v] = rigid(np.array(camera["R"]), np.array(camera["t"]))
    filmed = replace(context.rig, world_to_camera=poses)
    before, after = (missed(filmed, r, sources) for r in (context.calibrated_rig, context.rig))
    assert after < before / 3


def test_pictures_of_a_camera_kept_aside_are_nearer_to_what_it_filmed(
    corrected: tuple[Pipeline, list], tmp_path: Path
) -> None:
    """By more than half a decibel."""
    p = corrected[0]
    as_written = p.copy(tmp_path / "archive").with_settings("effects.calibration_correction=off")
    as_written.run()
    assert psnr(p) > psnr(as_written) + 0.5


def test_the_decision_is_the_same_when_it_is_taken_again(corrected: tuple[Pipeline, list], tmp_path: Path) -> None:
    """A second plan computes nothing; forced on it makes nothing anew that the decision had made."""
    p = corrected[0]
    assert p.plan().all_fresh
    forced = p.copy(tmp_path / "archive").with_settings("effects.calibration_correction=on")
    anew = {e.task.stage for e in forced.run() if isinstance(e, TaskDone)}
    assert anew <= {"survey", "judge"}, "constants are taken for what is asked"


def test_forced_on_it_waits_for_the_turns(capture: Path, tmp_path: Path) -> None:
    p = written(capture, tmp_path, OFF, "effects.calibration_correction=on")
    context = p.plan().context
    assert context.effects["calibration_correction"].state == "undecided"
    assert TURNS in context.waits["frames"]
    order = [e.task.stage for e in p.run(selection=MADE) if isinstance(e, TaskDone)]
    assert order.index("judge") < order.index("frames")
    context = p.plan().context
    assert context.effects["calibration_correction"].state == "on"
    assert not np.array_equal(context.rig.rotations, context.calibrated_rig.rotations)


def test_paths_go_between_the_cameras_as_they_stand(capture: Path, tmp_path: Path) -> None:
    """What was planned along cameras as they are written down gives way in the same run, and nothing is left of it."""
    p = written(capture, tmp_path, OFF, "frames.range=0:1")
    before = set(p.plan("between").context.paths)
    p.run("between")
    plan = p.plan("between")
    assert plan.all_fresh
    (path,) = plan.context.paths
    assert path not in before
    assert Results(plan.context).has(f"rendering/{path}/color")


def test_exact_cameras_are_left_alone_and_in_small_pictures_no_left_out_view_is_drawn_for_it(
    capture: Path, tmp_path: Path
) -> None:
    p = written(capture, tmp_path, 0.0)
    stages = {e.task.stage for e in p.run(selection=MADE) if isinstance(e, TaskDone)}
    assert "judge" not in stages
    context = p.plan().context
    verdict = context.effects["calibration_correction"]
    assert verdict.state == "off"
    assert context.rig is context.calibrated_rig


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """Exact cameras, with pictures that are large enough to tell."""
    folder = tmp_path_factory.mktemp("exact")
    film(folder / "filmed", views=6, size=SMALLEST, frames=1)
    p = written(folder / "filmed", folder, 0.0, "frames.range=0:1", "judge.views=3")
    p.run(selection=MADE)
    return p


def test_where_links_tell_of_no_error_pictures_of_left_out_views_leave_exact_cameras_alone(exact: Pipeline) -> None:
    context = exact.plan().context
    assert context.noted[CALIBRATION].max() > 0
    assert context.effects["calibration_correction"].state == "off"
    assert context.rig is context.calibrated_rig


@pytest.mark.parametrize(("gain", "on"), [(-1.0, False), (0.08, False), (0.2, True)])
def test_there_they_have_to_be_better_by_more(exact: Pipeline, gain: float, on: bool) -> None:
    found = decided(exact, turns=exact.plan().context.noted[TURNS], scores=scored(20.0, 20.0 + gain))
    assert found is not None
    assert found.on == on


def decided(p: Pipeline, **noted: np.ndarray) -> Decision | None:
    context = p.plan().context
    evidence = context.evidence("frames")
    names = {"links": LINKS, "turns": TURNS, "scores": CALIBRATION}
    given = {LINKS: context.noted[LINKS], **{names[k]: v for k, v in noted.items()}}
    found: Evidence = replace(evidence, noted=given)
    return CALIBRATION_CORRECTION.decide(found, CALIBRATION_CORRECTION.threshold)


def scored(written: float, turned: float) -> np.ndarray:
    return np.array([[[written, 0.9, 1.0], [turned, 0.9, 1.0]]])


def test_left_out_views_have_the_last_word(corrected: tuple[Pipeline, list]) -> None:
    p = corrected[0]
    turns = p.plan().context.noted[TURNS]
    assert decided(p) is None, "the judge is asked"
    for turned_psnr, on in ((21.0, True), (19.0, False), (20.04, False)):
        found = decided(p, turns=turns, scores=scored(20.0, turned_psnr))
        assert found is not None
        assert found.on == on
    blind = decided(p, turns=turns, scores=np.full((1, 2, 3), NONE))
    assert blind is not None
    assert not blind.on


def test_links_that_turns_do_not_bring_together_turn_nobody(corrected: tuple[Pipeline, list]) -> None:
    """Scattered outlines are masks that are wrong, not cameras, and few links say nothing: either settles it before a
    picture is drawn."""
    p = corrected[0]
    links = p.plan().context.noted[LINKS]
    rig, random = p.plan().context.calibrated_rig, np.random.default_rng(0)
    scattered = links[:, :, :1] + random.normal(size=links.shape) * 20 / rig.intrinsics[0, 0, 0]
    scattered = np.where(links[:, :, :1].any(axis=-1, keepdims=True), scattered, 0.0)
    found = decided(p, links=scattered)
    assert found is not None
    assert not found.on
    assert found.reason.endswith("that is not what is wrong")
    none = decided(p, links=np.zeros_like(links))
    assert none is not None
    assert (none.on, none.measured) == (False, None)


def _middle(rig: Rig) -> np.ndarray:
    """Where all cameras look."""
    across = [np.eye(3) - np.outer(a, a) for a in rig.rotations[:, 2]]
    right = [a @ c for a, c in zip(across, rig.centres, strict=True)]
    return np.asarray(np.linalg.lstsq(np.concatenate(across), np.concatenate(right), rcond=None)[0])
