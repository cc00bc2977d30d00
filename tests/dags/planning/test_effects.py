"""Decisions in plans and runs: the survey first, then what follows; only the decision makes anything stale."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from posegaussian.dags.diagnostics.effects_table import effects_reasons, effects_table, seconds
from posegaussian.dags.planning import effects
from posegaussian.dags.planning.forecast import History
from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task, dependencies, source_spans
from posegaussian.dags.runtime.events import EffectsDecided, TaskDone
from posegaussian.storage.archive.ledger import rebuild
from posegaussian.storage.archive.receipts import scan_receipts, write_receipt
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import FORCED, NAME, Pipeline, film

AUTO = [f"effects.{e}=auto" for e in FORCED]


@pytest.fixture(scope="module")
def decided(person_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """The clean person after a run with every effect on auto. Read it, do not change it."""
    p = Pipeline(
        tmp_path_factory.mktemp("decided") / "archive", person_folder, [*AUTO, "depth.method=hull", "frames.range=0:4"]
    )
    p.register()
    p.run()
    return p


@pytest.fixture
def fresh(person_folder: Path, tmp_path: Path) -> Pipeline:
    """Registered, never run."""
    p = Pipeline(tmp_path / "archive", person_folder, [*AUTO, "depth.method=hull", "frames.range=0:2"])
    p.register()
    return p


def reasons(p: Pipeline, stage: str) -> set[str]:
    return {
        r for v in p.plan().verdicts.values() if v.task.stage == stage and v.state is not State.FRESH for r in v.reasons
    }


def alter_notes(p: Pipeline, array: str, change: float) -> None:
    """Multiply what the survey noted, as a slightly different sample would."""
    sequence = Archive.open(str(p.root)).sequence(NAME)
    for r in list(scan_receipts(sequence)):
        if r.stage == "survey":
            r.facts["noted"][array] = [v * change for v in r.facts["noted"][array]]
            write_receipt(sequence, r)


def test_before_the_survey_effects_are_open_and_their_stages_wait_for_it(fresh: Pipeline) -> None:
    plan = fresh.plan()
    states = {n: v.state for n, v in plan.context.effects.items()}
    assert states["exposure_matching"] == states["temporal_smoothing"] == "undecided"
    assert states["undistortion"] == states["crop_scale"] == "off"
    surveys = {Task(NAME, "survey", None, v) for v in plan.context.views.sources}
    assert surveys <= set(dependencies(plan.context, Task(NAME, "frames", 0, 0)))
    assert surveys <= set(dependencies(plan.context, Task(NAME, "smoothing", 0)))
    assert surveys <= set(dependencies(plan.context, Task(NAME, "pose", 0))), "how cameras stand is open"
    told = fresh.with_settings("effects.calibration_correction=off").plan().context
    assert not surveys & set(dependencies(told, Task(NAME, "pose", 0))), "nothing of pose is open"


def test_a_run_decides_after_the_survey_and_goes_on(fresh: Pipeline) -> None:
    events = fresh.run()
    told, by_judge = [e for e in events if isinstance(e, EffectsDecided)]
    assert told.sequence == by_judge.sequence == NAME
    # features tell no light of so small pictures; what the judge's depth shows of the surface might
    assert [s.split(" (auto): ")[0] for s in by_judge.sentences] == ["exposure_matching off"]
    assert [s.split(" (auto): ")[0] for s in told.sentences] == [
        "calibration_correction off",
        "noise_averaging off",
        "outline_redrawing off",
        "outline_correction off",
        "gap_opening off",
        "temporal_smoothing off",
        "limb_bounds on",
        "pose_blending off",
        "source_detail off",
        "silhouette_clipping on",
        "hole_filling on",
        "outline_evening on",
    ]
    order = [(e.task.stage, e.task.view) for e in events if isinstance(e, TaskDone)]
    stages = [s for s, _ in order]
    assert "smoothing" not in stages
    assert max(order.index(("survey", v)) for v in range(6)) < stages.index("frames")
    assert max(order.index(("survey", v)) for v in range(6)) < stages.index("pose"), "how cameras stand is open"
    plan = fresh.plan()
    assert plan.all_fresh
    assert plan.unneeded["smoothing"] == "the effect temporal_smoothing is off"
    assert fresh.ran() == {}


def test_joints_do_not_wait_for_what_pictures_wait_for(fresh: Pipeline) -> None:
    """Where it is settled how cameras stand."""
    settled = fresh.with_settings("effects.calibration_correction=off")
    stages = [e.task.stage for e in settled.run() if isinstance(e, TaskDone)]
    assert stages.index("pose") < stages.index("frames")


def test_a_slightly_different_measure_makes_nothing_stale(decided: Pipeline, tmp_path: Path) -> None:
    p = decided.copy(tmp_path / "archive")
    before = p.plan().context.effects["temporal_smoothing"].decision
    alter_notes(p, "survey/motion", 1.3)
    after = p.plan().context.effects["temporal_smoothing"].decision
    assert before is not None
    assert after is not None
    assert before.reason != after.reason, "the measure did change"
    assert p.plan().all_fresh


def test_a_measure_that_crosses_its_bound_changes_the_decision_and_what_hangs_on_it(
    decided: Pipeline, tmp_path: Path
) -> None:
    p = decided.copy(tmp_path / "archive")
    sequence = Archive.open(str(p.root)).sequence(NAME)
    for r in list(scan_receipts(sequence)):
        if r.stage == "survey":
            r.facts["noted"]["survey/motion"] = [2.0, 3.0, 50.0]
            write_receipt(sequence, r)
    plan = p.plan()
    assert plan.context.effects["temporal_smoothing"].state == "on"
    assert reasons(p, "smoothing") == {"never made"}
    assert {v.task.stage for v in plan.verdicts.values() if v.state is not State.FRESH} == {"smoothing"}


def test_ten_more_frames_change_no_decision_and_no_partition_that_was_whole(tmp_path: Path) -> None:
    folder = tmp_path / "capture"
    film(folder, views=3, frames=4, depth=False)
    p = Pipeline(tmp_path / "archive", folder, [*AUTO, "depth.method=hull", "effects.limb_bounds=off"])
    p.register()
    p.run()
    film(folder, views=3, frames=14, depth=False)
    p.register()
    stale = [v.task for v in p.plan().verdicts.values() if v.state is not State.FRESH]
    of_frames = [t.partition for t in stale if t.stage in ("frames", "survey", "depth")]
    assert sorted(set(of_frames)) == [
        2,
        3,
        4,
        5,
        6,
    ], "pose, and what follows from it, is another matter: a file of joints holds all frames"
    assert any("survey was taken before" in n for n in p.plan().notes)


def test_from_survey_takes_the_measures_anew(decided: Pipeline, tmp_path: Path) -> None:
    p = decided.copy(tmp_path / "archive")
    alter_notes(p, "survey/motion", 100.0)
    plan = p.plan(selection=Selection(start="survey"))
    assert plan.context.effects["temporal_smoothing"].state == "undecided", (
        "a survey that will be taken anew decides nothing"
    )
    p.run(selection=Selection(start="survey"))
    assert p.plan().context.effects["temporal_smoothing"].state == "off"


def test_the_survey_works_on_all_frames_of_the_range_whatever_a_partition_holds(decided: Pipeline) -> None:
    assert source_spans(decided.context(), Task(NAME, "survey", None, 0))["pictures"] == range(4)


def test_the_size_of_the_frames_is_nothing_to_the_survey(decided: Pipeline) -> None:
    plan = decided.with_settings("frames.size=32", "effects.exposure_matching=off").plan()
    assert set(plan.counts("survey")) == {State.FRESH}
    assert plan.counts("frames")[State.STALE] > 0
    assert not plan.context.waits, "what it noted decides at any size"


@pytest.mark.parametrize(
    ("worked", "why"), [("0:2", set()), ("1:6", set()), ("4:6", {"frames 4..5 are worked on, survey looked at 0..3"})]
)
def test_the_survey_is_taken_anew_for_frames_of_which_it_saw_less_than_half(
    decided: Pipeline, tmp_path: Path, worked: str, why: set[str]
) -> None:
    p = decided.copy(tmp_path / "archive").with_settings(f"frames.range={worked}")
    assert reasons(p, "survey") == why
    if why:
        p.run(selection=Selection(only=frozenset({"survey"})), expect_failure=True)
        assert reasons(p, "survey") == set()
        assert reasons(decided.copy(tmp_path / "other").with_settings(f"frames.range={worked}"), "survey") == why


@pytest.mark.parametrize("setting", ["on", "off"])
def test_forcing_overrides_the_measure_and_is_named_with_old_and_new_state(
    decided: Pipeline, tmp_path: Path, setting: str
) -> None:
    p = decided.copy(tmp_path / "archive").with_settings(f"effects.left_right_check={setting}", "depth.method=sgbm")
    verdict = p.plan().context.effects["left_right_check"]
    assert verdict.state == setting
    assert f"effects.left_right_check is {setting}" in verdict.sentence
    change = {"effect left_right_check off -> on"} if setting == "on" else set()
    assert {r for r in reasons(p, "depth") if not r.startswith("input")} == {"depth.method hull -> sgbm", *change}


def test_a_forced_effect_asks_nothing_of_the_survey(fresh: Pipeline) -> None:
    forced = fresh.with_settings(
        "effects.temporal_smoothing=on",
        "effects.calibration_correction=off",
        "effects.noise_averaging=off",
        "effects.exposure_matching=off",
        "effects.outline_correction=off",
        "effects.gap_opening=off",
        "effects.outline_redrawing=off",
        "effects.limb_bounds=on",
        "effects.pose_blending=off",
        "effects.source_detail=on",
        "effects.silhouette_clipping=off",
        "effects.hole_filling=on",
        "effects.outline_evening=on",
    )
    assert "survey" in forced.plan().unneeded
    half = fresh.with_settings(
        "effects.calibration_correction=off",
        "effects.noise_averaging=off",
        "effects.exposure_matching=off",
        "effects.outline_correction=off",
        "effects.gap_opening=off",
        "effects.outline_redrawing=off",
        "effects.limb_bounds=on",
        "effects.pose_blending=off",
        "effects.source_detail=off",
        "effects.silhouette_clipping=off",
        "effects.hole_filling=off",
        "effects.outline_evening=off",
    )
    assert {w for w in half.plan().context.facts if w.startswith("survey/")} == {"survey/motion"}


def test_what_the_survey_took_besides_stays_when_less_is_asked_and_is_retaken_when_more_is(
    decided: Pipeline, tmp_path: Path
) -> None:
    less = decided.with_settings("effects.exposure_matching=off")
    assert less.plan().all_fresh
    more = decided.copy(tmp_path / "archive").with_settings("frames.matte=plate")
    # a plate tells, too, whether a camera's light changes
    assert reasons(more, "survey") == {f"survey/{a} is asked for" for a in ("drift", "plate", "spread")}


def test_a_failed_survey_blocks_what_waits_for_it(fresh: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object) -> None:
        raise RuntimeError("no light")

    monkeypatch.setattr("posegaussian.stages.survey.algorithms.motion.jitter_and_motion", fail)
    events = fresh.run(expect_failure=True)
    blocked = {e.task.stage for e in events if type(e).__name__ == "TaskBlocked"}
    assert {"frames", "smoothing"} <= blocked
    assert not [e for e in events if isinstance(e, EffectsDecided)]
    monkeypatch.undo()
    fresh.run()
    assert fresh.plan().all_fresh


def test_an_effect_a_capture_lacks_the_ground_for_is_off_even_where_it_is_forced_on(tmp_path: Path) -> None:
    """So that one setting can hold for a hundred sequences."""
    film(tmp_path / "capture", views=3, frames=2, joints=False, depth=False)
    p = Pipeline(
        tmp_path / "archive",
        tmp_path / "capture",
        ["effects.temporal_smoothing=on", "effects.pose_blending=on", "effects.pose_heatmaps=on"],
    )
    p.register()
    verdicts = p.plan().context.effects
    for name in ("temporal_smoothing", "pose_blending", "pose_heatmaps"):
        assert verdicts[name].state == "off"
        assert f"effects.{name} is on, but" in verdicts[name].sentence


def test_a_crop_that_sizes_need_cannot_be_switched_off(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=3, frames=1, depth=False)
    cameras = tmp_path / "capture" / "cameras.json"
    cameras.write_text(cameras.read_text().replace('"width": 48', '"width": 50'))
    assert '"width": 50' in cameras.read_text()
    crop = "frames.crop={" + ", ".join(f"{c}: {{offset: [1, 0]}}" for c in ("cam00", "cam01", "cam02", "mid00")) + "}"
    p = Pipeline(tmp_path / "archive", tmp_path / "capture", [crop])
    p.register()
    assert p.plan().context.effects["crop_scale"].state == "on"
    with pytest.raises(
        ConfigError,
        match=r"effects.crop_scale is off, but pictures of cam00 are 48x48 px and its calibration is for 50x48",
    ):
        p.with_settings("effects.crop_scale=off").plan()


def test_the_documentation_lists_every_effect_with_its_measure_and_bound() -> None:
    text = (Path(__file__).resolve().parents[3] / "docs/reference/effects.md").read_text()
    for name, (e, _) in effects.declared().items():
        assert f"| `{name}` | {e.measure} | {e.quantity(f'{e.threshold:g}')} | {e.summary} |" in text


def shown(p: Pipeline, rows: list[dict[str, object]] | None = None) -> str:
    out = io.StringIO()
    plan = p.plan()
    Console(width=80, file=out).print(effects_table(plan, rows or []))
    return "\n".join([out.getvalue(), *effects_reasons(plan)])


def test_the_table_shows_every_effect_and_the_masks_with_state_and_reason(fresh: Pipeline, decided: Pipeline) -> None:
    before, after = shown(fresh), shown(decided.with_settings("effects.undistortion=off"))
    for name in effects.declared():
        assert name in before
        assert name in after
    assert "after survey" in before
    assert "undecided (auto)" in before
    assert "after survey" not in after
    assert "off (forced)" in after
    for text in (before, after):
        assert "frames.matte" in text
        assert "given (auto)" in text
        assert "the capture came with masks of every view" in text


def test_seconds_come_from_the_history_with_and_without_the_effect(decided: Pipeline, tmp_path: Path) -> None:
    p = decided.copy(tmp_path / "archive")
    unknown = seconds(p.plan(), p.plan().context.effects["temporal_smoothing"], _rows(p))
    assert unknown is None
    smooth = p.with_settings("effects.temporal_smoothing=on")
    smooth.run()
    spent = seconds(smooth.plan(), smooth.plan().context.effects["temporal_smoothing"], _rows(p))
    assert spent is not None
    assert spent > 0
    assert "spends" in shown(smooth, _rows(p))
    assert "saves" in shown(p, _rows(p))


def _rows(p: Pipeline) -> list[dict[str, object]]:
    archive = Archive.open(str(p.root))
    rebuild(archive)
    return History.read(archive).timed  # type: ignore[return-value]


def test_only_states_that_are_on_are_kept_in_a_receipt(decided: Pipeline) -> None:
    found = {r.stage: r.parts["effects"] for r in scan_receipts(Archive.open(str(decided.root)).sequence(NAME))}
    assert found["pose"] == {"pose_heatmaps": "on"}
    assert found["frames"] == {}
    assert json.dumps(found)
