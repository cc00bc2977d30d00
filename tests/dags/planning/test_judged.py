"""Decisions by left-out views: who is asked, when, and what a run then does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.diagnostics.effects_table import effects_reasons
from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import EffectsDecided, TaskDone
from posegaussian.stages.contract.declaration import Decision, Picked
from posegaussian.stages.contract.judged import DEPTH, EXPOSURE, GIVEN_MATTE, NONE, SHARED_LIGHT
from posegaussian.stages.depth.choice import AHEAD, TIE, pick, tried
from posegaussian.stages.depth.methods.registry import BY_PICTURES, METHODS
from posegaussian.stages.frames.effects import CLEAR_GAIN, EXPOSURE_MATCHING, LIKELY
from posegaussian.stages.frames.exposures import SURFACE
from posegaussian.stages.imaging.exposure import NONE as UNSEEN
from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from posegaussian.storage.archive.receipts import scan_receipts, write_receipt
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline, film

AUTO = ["depth.method=auto", "frames.range=0:2", "judge.views=3"]


@pytest.fixture(scope="module")
def judged(person_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Pipeline, list]:
    p = Pipeline(tmp_path_factory.mktemp("judged") / "archive", person_folder, AUTO)
    p.register()
    assert p.plan().context.choices["depth.method"].state == "undecided"
    return p, p.run()


def test_the_judge_runs_first_and_its_word_is_the_reason(judged: tuple[Pipeline, list]) -> None:
    p, events = judged
    order = [e.task.stage for e in events if isinstance(e, TaskDone)]
    assert order.index("judge") < order.index("depth")
    (told,) = [s for e in events if isinstance(e, EffectsDecided) for s in e.sentences]
    assert told.startswith("depth.method: left-out source views")
    plan = p.plan()
    assert plan.all_fresh
    assert any(r.startswith("depth.method ") and " dB" in r for r in effects_reasons(plan))


def test_other_scores_change_the_method_and_depth_alone_is_made_anew(
    judged: tuple[Pipeline, list], tmp_path: Path
) -> None:
    p = judged[0].copy(tmp_path / "archive")
    before = p.plan().context.choices["depth.method"].state
    other = next(i for i, m in enumerate(BY_PICTURES) if f"{m}_depth" != before)
    sequence = Archive.open(str(p.root)).sequence(NAME)
    for r in list(scan_receipts(sequence)):
        if r.stage == "judge":
            scores = np.array(r.facts["noted"][DEPTH])
            scores[:, other] = np.where(scores[:, other] < 0, scores[:, other], 99.0)
            r.facts["noted"][DEPTH] = scores.tolist()
            write_receipt(sequence, r)
    plan = p.plan()
    assert plan.context.choices["depth.method"].state == f"{BY_PICTURES[other]}_depth"
    assert {v.task.stage for v in plan.verdicts.values() if v.state is State.STALE} == {"depth"}


def test_other_roles_say_of_no_picture_that_it_changed(judged: tuple[Pipeline, list]) -> None:
    """The judge is made anew for them, and is not kept."""
    p = Pipeline(judged[0].root, judged[0].folder, AUTO, held_out="[]")
    plan = p.plan()
    assert set(plan.counts("judge")) == {State.STALE}
    assert not [n for n in plan.notes if n.startswith("judge was taken before")]


def test_a_method_that_is_set_asks_nobody(judged: tuple[Pipeline, list]) -> None:
    plan = judged[0].with_settings("depth.method=hull").plan()
    assert "judge" in plan.unneeded
    assert not plan.context.choices


@pytest.mark.parametrize(("views", "matte"), [(2, "auto"), (4, "none")])
def test_where_nothing_can_be_judged_the_choice_falls_back_and_says_why(tmp_path: Path, views: int, matte: str) -> None:
    film(tmp_path / "capture", views=views, frames=2, held_out=0, depth=False)
    p = Pipeline(tmp_path / "archive", tmp_path / "capture", [*AUTO, f"frames.matte={matte}"], held_out="[]")
    p.register()
    plan = p.plan()
    verdict = plan.context.choices["depth.method"]
    assert verdict.state == "sweep_depth"
    assert ("2 source views" if views == 2 else "everything is foreground") in verdict.sentence
    assert "judge" in plan.unneeded


NEAR = tuple(m for m in BY_PICTURES if m != "sgbm")
"""What left-out views are drawn by where cameras stand near each other."""
MATCHING = sorted((m for m in BY_PICTURES if METHODS[m].matches), key=lambda m: METHODS[m].seconds)
"""The cheapest first."""


def _drawn(**psnr: float) -> np.ndarray:
    """[method] dB; 20 where nothing is said."""
    return np.array([psnr.get(m, 20.0) for m in BY_PICTURES])


def test_the_better_picture_wins(judged: tuple[Pipeline, list]) -> None:
    for name in BY_PICTURES:
        lead = TIE + 0.01 if name in MATCHING else AHEAD + 0.01
        assert _picked(judged[0], _drawn(**{name: 20 + lead})).fact == f"{name}_depth"


def test_of_methods_that_draw_alike_the_cheapest_is_picked_and_the_reason_says_so(
    judged: tuple[Pipeline, list],
) -> None:
    for name in MATCHING:
        picked = _picked(judged[0], _drawn(**{name: 20 + TIE - 0.01}))
        assert picked.fact == f"{MATCHING[0]}_depth"
        assert ("costs least" in picked.reason) == (name != MATCHING[0])


def test_a_surface_that_compares_no_pictures_must_lead_by_far_and_the_reason_says_so(
    judged: tuple[Pipeline, list],
) -> None:
    picked = _picked(judged[0], _drawn(hull=20 + TIE + AHEAD, **{MATCHING[1]: 20 + TIE + 0.01}))
    assert picked.fact == f"{MATCHING[1]}_depth"
    assert "hull, which compares no pictures, leads by less than 1 dB" in picked.reason
    assert "costs least" not in picked.reason
    assert "leads" not in _picked(judged[0], _drawn(hull=20 - TIE - 0.01)).reason


@pytest.mark.parametrize(("views", "asked"), [(4, False), (6, True), (8, False), (12, False), (16, False)])
def test_sgbm_is_asked_only_where_cameras_stand_neither_near_by_nor_far_apart(views: int, asked: bool) -> None:
    """All around 60 degrees apart, of 90, 60, 45, 30 and 22; along an arc 45, of 45 and 30."""
    rig = capture_person(views=views, size=16, frames=1, held_out=0).rig
    assert tried(rig, range(views)) == (BY_PICTURES if asked else NEAR)
    assert tried(rig, range(0, views, 2)) == (BY_PICTURES if views == 12 else NEAR), "of the sources alone"
    if views == 8:
        assert tried(rig, [0, 1, 2, 3, 4, 5, 6]) == BY_PICTURES, "those at the ends have one neighbour, 45 degrees away"
    if views == 12:
        assert tried(rig, [0, 1, 2, 3]) == NEAR, "30 degrees away one is enough"
        assert tried(rig, [0, 1]) == BY_PICTURES, "of two cameras neither is left out"


def test_a_method_that_was_not_asked_is_neither_picked_nor_named(judged: tuple[Pipeline, list]) -> None:
    picked = _picked(judged[0], _drawn(sgbm=NONE))
    assert picked.fact == "sweep_depth"
    assert "sgbm" not in picked.reason


def test_where_cameras_stand_near_the_judge_draws_nothing_by_sgbm(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=8, frames=1, held_out=0, depth=False)
    settings = ["depth.method=auto", "judge.views=2", "judge.frames=1", "network.weights=none", "refinement.steps=0"]
    p = Pipeline(tmp_path / "archive", tmp_path / "capture", settings, held_out="[]")
    p.register()
    p.run(selection=Selection(only=frozenset({"survey", "judge"})))
    scores = p.plan().context.noted[DEPTH]
    asked = (scores != NONE).any(axis=(0, 2))
    assert [m for m, there in zip(BY_PICTURES, asked, strict=True) if there] == list(NEAR)


def _picked(p: Pipeline, psnr: np.ndarray) -> Picked:
    """What is picked where all pictures have the `psnr` [method]."""
    evidence = p.plan().context.evidence("depth")
    assert GIVEN_MATTE in evidence.facts
    scores = np.full((4, 3, 3), 0.9)
    scores[:, :, 0] = psnr
    scores[:, psnr == NONE] = NONE
    picked = pick(replace(evidence, noted={DEPTH: scores}))
    assert picked is not None
    return picked


def features(count: int, stops: float, points: int = 40) -> np.ndarray:
    """survey/surface of so many source views in a rig of as many, of which the first is brighter by `stops`."""
    out = np.full((count, count, 64, 3), UNSEEN)
    out[0, 1:, :points] = stops
    return out


def decided(p: Pipeline, noted: dict[str, np.ndarray]) -> Decision | None:
    evidence = p.plan().context.evidence("frames")
    found = replace(evidence, sources=(0, 1, 2), rig=evidence.rig.subset([0, 1, 2]), noted=noted)
    return EXPOSURE_MATCHING.decide(found, EXPOSURE_MATCHING.threshold)


def test_the_judge_is_asked_for_gains_unless_features_show_that_cameras_are_alike(
    judged: tuple[Pipeline, list],
) -> None:
    p = judged[0]
    alike = decided(p, {SURFACE: features(3, 0.1)})
    assert alike is not None
    assert not alike.on
    assert decided(p, {SURFACE: features(3, 0.6)}) is None
    assert decided(p, {SURFACE: features(3, 0.0, points=0)}) is None, "its depth shows what features do not"


def test_gains_are_those_of_the_surface_that_the_judge_saw_and_are_applied_where_they_draw_better(
    judged: tuple[Pipeline, list],
) -> None:
    """Features are half a stop off; the surface says that the first camera is brighter by one, or that none is."""
    p = judged[0]
    seen = features(3, 1.0, points=64)
    better, worse = (np.array([[[20.0, 0.9, 1.0], [psnr, 0.9, 1.0]]]) for psnr in (21.0, 19.0))
    for light, scores, on in ((seen, better, True), (seen, worse, False), (0 * seen, better, False)):
        noted = {SURFACE: features(3, 0.5), SHARED_LIGHT: np.where(seen < UNSEEN, light, UNSEEN), EXPOSURE: scores}
        found = decided(p, noted)
        assert found is not None
        assert found.on == on
        if on:
            assert "differ by 1.00 stops" in found.reason


@pytest.mark.parametrize(
    ("stops", "gained", "on"),
    [(0.3, 0.9, False), (0.3, 1.1, True), (0.2, 50.0, False), (0.6, 0.0, True), (0.6, -0.1, False)],
)
def test_half_of_the_bound_suffices_where_gains_draw_clearly_better(
    judged: tuple[Pipeline, list], stops: float, gained: float, on: bool
) -> None:
    """`gained`: dB, over what is clear."""
    seen, bound = features(3, stops, points=64), EXPOSURE_MATCHING.threshold
    scores = np.array([[[20.0, 0.9, 1.0], [20.0 + gained * CLEAR_GAIN, 0.9, 1.0]]])
    found = decided(judged[0], {SURFACE: features(3, 0.5), SHARED_LIGHT: seen, EXPOSURE: scores})
    assert found is not None
    assert found.on == on
    assert isinstance(found.measured, float)
    at = np.searchsorted([LIKELY * bound, bound], found.measured)
    assert at == {0.2: 0, 0.3: 1, 0.6: 2}[stops], "below half of the bound, below the bound, above it"
    assert ("stops suffice" in found.reason) == (on and at == 1)
