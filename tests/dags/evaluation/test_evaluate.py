"""Methods are measured alike, beside the user's results, and what was measured once is not computed again."""

from __future__ import annotations

import itertools
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.evaluation import evaluate as evaluation
from posegaussian.dags.evaluation.asked import asked
from posegaussian.dags.evaluation.evaluate import Evaluation, evaluate, measurable
from posegaussian.dags.evaluation.measured import REGIONS, pictures
from posegaussian.dags.evaluation.methods import OURS, chosen
from posegaussian.dags.evaluation.results import Result, with_means
from posegaussian.dags.evaluation.tables import columns, definitions, latex, markdown, rows
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.variants import others
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.errors import ConfigError
from tests.dags.cli.test_cli import assert_says, posegaussian
from tests.dags.tradeoff.test_tradeoff import files
from tests.support.pipeline import NAME, Pipeline


@pytest.fixture(scope="module")
def evaluated(finished: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> tuple[Pipeline, Evaluation, dict]:
    """Ours and the hull on a finished archive: (archive, what came of it, files before)."""
    archive = finished.copy(tmp_path_factory.mktemp("evaluated") / "archive")
    before = files(archive.root / NAME)
    return archive, evaluate(archive.session, [NAME], chosen(f"{OURS},hull")), before


def of(made: Evaluation, method: str) -> Result:
    return next(r for r in made.results if r.method == method)


def test_numbers_are_the_means_of_the_metrics_table(evaluated: tuple) -> None:
    archive, made, _ = evaluated
    (path,) = archive.context().paths
    table = Results(archive.context()).table("metrics/{path}", path)
    numbers = of(made, OURS).numbers
    for measure, region in itertools.product(("psnr", "ssim"), REGIONS):
        values = [r["value"] for r in table if (r["measure"], r["region"]) == (measure, region)]
        assert len(values) == 6
        assert numbers[measure, region, "mean"].value == pytest.approx(np.mean(values), rel=1e-12)
        assert region == "full" or f"{region} = " in numbers[measure, region, "mean"].definition
    changes = [r["value"] for r in table if (r["measure"], r["region"]) == ("delta_ssim", "box")]
    assert numbers["delta_ssim", "box", "mean"].value == pytest.approx(np.mean(changes), rel=1e-12)
    assert numbers["delta_ssim", "box", "deviation"].value == pytest.approx(np.std(changes), rel=1e-12)


def test_seconds_are_those_of_the_receipts_and_gaussians_are_counted(evaluated: tuple) -> None:
    archive, made, _ = evaluated
    spent = {r.stage: 0.0 for r in scan_receipts(archive.context().sequence)}
    for r in scan_receipts(archive.context().sequence):
        spent[r.stage] += r.facts["seconds"] - r.facts["warm_up"]
    numbers = of(made, OURS).numbers
    a_frame = sum(s for stage, s in spent.items() if stage not in ("metrics", "survey", "judge")) / 6
    assert numbers["ms_a_frame", "", "mean"].value == pytest.approx(1000 * a_frame)
    assert numbers["frames_a_second", "", "mean"].value == pytest.approx(1 / a_frame)
    assert numbers["drawing", "", "mean"].value == pytest.approx(1000 * spent["rendering"] / 6)
    results, context = Results(archive.context()), archive.context()
    depth, opacity = (
        np.stack([results.read(a, range(6), v) for v in context.views.sources])
        for a in ("depth/depth", "gaussians/opacity")
    )
    drawn = (depth > 0) & (opacity[:, :, 0] > 0)
    assert numbers["gaussians", "", "mean"].value == pytest.approx(drawn.sum() / 6)


def test_no_byte_of_the_users_sequence_changes_and_methods_share_what_is_equal(evaluated: tuple) -> None:
    archive, _, before = evaluated
    assert files(archive.root / NAME) == before
    mine, beside = others(archive.context().sequence)
    made = {(r.stage, r.partition, r.view): r.facts["started"] for r in scan_receipts(mine)}
    for r in scan_receipts(beside):
        shared = made[r.stage, r.partition, r.view] == r.facts["started"]
        assert shared is (r.stage not in ("depth", "gaussians", "rendering", "metrics")), r.stage


def test_a_second_call_computes_nothing_and_says_the_same(evaluated: tuple) -> None:
    archive, made, _ = evaluated
    before = files(archive.root)
    again = evaluate(archive.session, [NAME], chosen(f"{OURS},hull"))
    assert again.results == made.results
    after = files(archive.root)
    assert {k for k in after if "_receipts" in k} == {k for k in before if "_receipts" in k}
    assert all(after[k] == v for k, v in before.items() if "_receipts" in k or "/c." in k)


def test_only_frames_that_are_worked_on_are_measured(finished: Pipeline, tmp_path: Path) -> None:
    """Rows of other frames may lie in the archive from before."""
    archive = finished.copy(tmp_path / "archive")
    made = evaluate(archive.with_settings("frames.range=0:3").session, [NAME], chosen(OURS))
    (ours,) = made.results
    assert ours.numbers["psnr", "box", "mean"].count == 3
    assert ours.numbers["delta_ssim", "box", "mean"].count == 2


def test_other_methods_are_measured_alike_and_said_what_they_cost(evaluated: tuple) -> None:
    archive, made, _ = evaluated
    few = archive.with_settings("rendering.fit_steps=3")
    peers = evaluate(few.session, [NAME], chosen("ibr,3dgs"))
    assert peers.status == 0
    hull, ibr, fit = of(made, "hull"), of(peers, "ibr"), of(peers, "3dgs")
    for key, number in hull.numbers.items():
        if key[0] in ("psnr", "ssim", "delta_ssim"):
            assert all(r.numbers[key].definition == number.definition for r in (ibr, fit))
            assert all(r.numbers[key].count == number.count for r in (ibr, fit))
    optimised, drawing = ("optimised", "", "mean"), ("drawing", "", "mean")
    assert fit.numbers[optimised].value > 0 == ibr.numbers[optimised].value
    a_frame = fit.numbers["ms_a_frame", "", "mean"].value / 1000
    assert a_frame > fit.numbers[optimised].value + fit.numbers[drawing].value / 1000 - 1e-9
    assert fit.numbers["gaussians", "", "mean"].value > 3
    assert ibr.numbers["gaussians", "", "mean"].value is None
    assert "no Gaussians" in ibr.numbers["gaussians", "", "mean"].definition


def test_what_cannot_be_run_is_said_and_never_made_up(evaluated: tuple) -> None:
    _, made, _ = evaluated
    refused = Result(NAME, of(made, OURS).data_set, "given", why="the capture has no depth maps")
    page = "\n".join(markdown([*made.results, refused], made.protocol))
    assert "given: not run: the capture has no depth maps" in page
    assert re.search(r"\| given +\| not run", page)
    (row,) = rows([refused])
    assert (row["value"], row["count"], row["definition"]) == (None, 0, "not run: the capture has no depth maps")


def test_every_form_of_the_table_says_the_same_numbers(evaluated: tuple) -> None:
    _, made, _ = evaluated
    told = {(r["method"], r["measure"], r["region"], r["statistic"]): r for r in rows(made.results)}
    page, tex = markdown(made.results, made.protocol), "\n".join(latex(made.results, made.protocol))
    for method in (OURS, "hull"):
        (line,) = [x for x in page if f" {method} " in x and x.startswith("|")]
        cells = [c.strip() for c in line.strip("|").split("|")][2:]
        shown = columns(made.results)
        assert len(cells) == len(shown)
        for cell, column in zip(cells, shown, strict=True):
            row = told[method, *column.key]
            assert float(cell) == pytest.approx(row["value"], rel=0.05, abs=1e-4)
            assert row["definition"]
            assert cell in tex
    assert tex.count(r"\toprule") == 1
    assert made.protocol.startswith(
        "Protocol: what held-out cameras filmed (mid00 (48 x 48 px, 6 source views, 6 frames)"
    )
    assert "LPIPS was not measured" in made.protocol


def row(camera: str, frame: int, measure: str, value: float | None, region: str = "box") -> dict:
    return {
        "camera": camera,
        "frame": frame,
        "region": region,
        "measure": measure,
        "value": value,
        "definition": "d" if value is not None else "not available: why",
    }


def test_changes_are_averaged_over_the_frames_of_a_camera_then_over_cameras() -> None:
    changes = [row("a", f, "delta_ssim", v) for f, v in enumerate((0.1, 0.3))] + [row("b", 0, "delta_ssim", 0.6)]
    mean, deviation = pictures(changes)
    assert mean.value == pytest.approx((0.2 + 0.6) / 2)
    assert deviation.value == pytest.approx(0.1), "a single change has no deviation"
    _, none = pictures(changes[2:])
    assert none.value is None


def test_a_measure_without_a_value_is_none_and_says_why() -> None:
    (number,) = pictures([row("a", 0, "lpips_alex", None)])
    assert (number.value, number.definition, number.count) == (None, "not available: why", 0)
    some, _ = pictures([row("a", 0, "psnr", 30.0), row("a", 1, "psnr", 20.0), row("a", 0, "lpips_alex", None)])
    assert (some.value, some.count) == (25.0, 2)


def test_a_mean_is_over_sequences_and_of_a_method_that_has_all_of_them(evaluated: tuple) -> None:
    _, made, _ = evaluated
    ours = of(made, OURS)
    other = Result("other", ours.data_set, OURS, ours.numbers)
    hull = of(made, "hull")
    missing = Result("other", hull.data_set, "hull", why="it failed")
    *_, mean, none = with_means([ours, hull, other, missing])
    assert (mean.sequence, mean.method, none.method) == ("mean of 2", OURS, "hull")
    for key, number in ours.numbers.items():
        assert mean.numbers[key].value == pytest.approx(number.value)
    assert not none.numbers
    assert "1 of 2" in none.why


def test_a_methods_settings_win_over_everything_the_user_set() -> None:
    set_by_user = ["depth.method=sgbm", "sequences={walk*: {depth: {method: truth, pairs: 3}}}"]
    configuration = load_configuration(None, set_by_user, folder=Path("/"))
    (hull,) = chosen("hull")
    over = hull.over(configuration)
    for name in ("walk1", "run1"):
        assert over.for_sequence(name).depth.method == "hull"
        assert over.for_sequence(name).network.weights == "none"
    assert over.for_sequence("walk1").depth.pairs == 3
    assert configuration.for_sequence("walk1").depth.method == "truth"


def test_sentences_for_what_cannot_be(finished: Pipeline) -> None:
    with pytest.raises(ConfigError, match=r"there is no method 'nerf'; there are posegaussian \(.*\); fast"):
        chosen("nerf")
    blind = finished.with_settings("views.held_out=[]")
    blind.held_out = "[]"
    with pytest.raises(
        ConfigError, match=r"person: no held-out camera to measure against; .*views\.held_out=\[mid00\]"
    ):
        measurable(blind.session, [])


def test_a_sequence_that_cannot_be_read_is_named_and_the_others_are_measured(evaluated: tuple, tmp_path: Path) -> None:
    archive = evaluated[0].copy(tmp_path / "archive")
    (archive.root / "broken").mkdir()
    (archive.root / "broken/zarr.json").write_text((archive.root / NAME / "zarr.json").read_text()[:-200])
    done = posegaussian("evaluate", *archive.options, "--methods", f"{OURS},hull", "--output", "out", cwd=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr
    (named,) = [line for line in done.stdout.splitlines() if line.startswith("broken: ")]
    assert "import the capture again" in named
    table = pq.read_table(tmp_path / "out/evaluation.parquet").to_pylist()
    assert {(r["sequence"], r["method"]) for r in table} == {(NAME, OURS), (NAME, "hull")}
    shutil.rmtree(archive.root / NAME)
    with pytest.raises(ConfigError, match=r"^broken: "):
        measurable(archive.session, [])


def test_a_method_that_one_sequence_cannot_have_loses_nothing_else(
    evaluated: tuple, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor does one that none can have."""
    archive = evaluated[0].copy(tmp_path / "archive")
    shutil.copytree(archive.root / NAME, archive.root / "other")
    made = evaluation.settled_variant

    def refusing(origin: SequenceGroup, settings: Any, different: dict[str, Any], paths: tuple[str, ...]) -> Context:
        if origin.name == "other" or different.get("rendering.method") == "ibr":
            raise ConfigError("that cannot be")
        return made(origin, settings, different, paths)

    monkeypatch.setattr(evaluation, "settled_variant", refusing)
    said = Console(record=True, width=200)
    session = replace(archive.session, console=said)
    found = evaluate(session, [NAME, "other"], chosen(f"{OURS},hull,ibr"))
    assert found.status == 1
    there = {(r.sequence, r.method): r.why for r in found.results if r.sequence in (NAME, "other")}
    refused = {("other", "hull"), (NAME, "ibr"), ("other", "ibr")}
    assert {k for k, why in there.items() if why} == refused
    assert all(there[k] == "that cannot be" for k in refused)
    words = said.export_text()
    page = markdown(found.results, found.protocol)
    for sequence, method in refused:
        assert f"{sequence}: {method}: that cannot be" in words
        assert f"- {sequence}, {method}: not run: that cannot be." in page
    ours = evaluate(archive.session, [NAME], chosen(f"{OURS},hull")).results
    assert [r for r in found.results if r.sequence == NAME][:2] == ours


def test_pictures_of_nobody_are_counted_below_the_table(evaluated: tuple) -> None:
    archive, made, _ = evaluated
    ours = of(made, OURS)
    assert ours.empty == 0
    told = markdown([replace(ours, empty=2)], made.protocol)
    assert told[-1] == f"- {NAME}: nobody is in 2 held-out pictures, which are not measured."
    plan = archive.session.plan(NAME, Selection(), ("held_out",))
    rows_of = [row("mid00", f, "psnr", 30.0) for f in range(6)]
    assert evaluation._empty(plan.context, rows_of[:4]) == 2
    assert evaluation._empty(plan.context, rows_of) == 0


def test_the_mean_of_rates_is_that_of_what_they_take(evaluated: tuple) -> None:
    _, made, _ = evaluated
    ours = of(made, OURS)
    rate, time = ("frames_a_second", "", "mean"), ("ms_a_frame", "", "mean")
    numbers = {
        rate: replace(ours.numbers[rate], value=1000 / (3 * ours.numbers[time].value)),
        time: replace(ours.numbers[time], value=3 * ours.numbers[time].value),
    }
    slower = replace(ours, sequence="other", numbers={**ours.numbers, **numbers})
    *_, mean = with_means([ours, slower])
    assert mean.numbers[rate].value == pytest.approx(1000 / mean.numbers[time].value)
    assert mean.numbers[rate].definition.startswith("harmonic mean over 2 sequences; ")


def test_what_is_missing_in_part_is_explained_below_the_table(evaluated: tuple) -> None:
    _, made, _ = evaluated
    ours = of(made, OURS)
    box, gaussians = ("psnr", "box", "mean"), ("gaussians", "", "mean")
    numbers = {k: n for k, n in ours.numbers.items() if k[1] != "box"}
    numbers[gaussians] = replace(numbers[gaussians], value=None, definition="not known: why")
    other = replace(ours, sequence="other", numbers=numbers)
    results = with_means([other, ours])
    page = markdown(results, made.protocol)
    assert f"- other, {OURS}: Gaussians a frame: not known: why." in page
    (line,) = [x for x in page if x.startswith(f"- other, {OURS}: PSNR, dB box; ")]
    assert line.endswith(": no picture of it has one.")
    (line,) = [x for x in page if x.startswith(f"- mean of 2, {OURS}: ")]
    assert line.endswith("; Gaussians a frame: there on 1 of 2 sequences.")
    assert results[-1].numbers[box].value is None
    (line,) = [x for x in definitions(results) if x.startswith("- Gaussians a frame: ")]
    assert "not known" not in line


def test_measures_that_are_asked_for_are_measured_on_sequences_with_some_of_their_own() -> None:
    own = ["sequences={walk*: {metrics: {measures: [ssim]}, depth: {pairs: 3}}, run: {depth: {pairs: 1}}}"]
    before = load_configuration(None, own, folder=Path("/"))
    after = load_configuration(None, [*own, *asked(before, "ms_ssim,psnr")], folder=Path("/"))
    plain = before.default.metrics.measures
    assert after.default.metrics.measures == after.for_sequence("run").metrics.measures == [*plain, "ms_ssim"]
    assert after.for_sequence("walk1").metrics.measures == ["ssim", "ms_ssim", "psnr"]
    assert [after.for_sequence(n).depth.pairs for n in ("walk1", "run")] == [3, 1], "all else stays"


def test_the_command_writes_three_files_and_ends_with_the_next_one(evaluated: tuple, tmp_path: Path) -> None:
    archive, made, _ = evaluated
    done = posegaussian("evaluate", *archive.options, "--methods", f"{OURS},hull", "--output", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("all fresh, nothing to do") == 2
    assert done.stdout.splitlines()[-1].startswith("next: posegaussian tradeoff --knob depth.method --sequence person")
    table = pq.read_table(tmp_path / "out/evaluation.parquet")
    assert table.schema.metadata[b"protocol"].decode() == made.protocol
    assert {"sequence", "data_set", "method", "measure", "region", "statistic", "value", "unit", "definition"} <= set(
        table.column_names
    )
    values = {tuple(r[k] for k in ("method", "measure", "region", "statistic")): r["value"] for r in table.to_pylist()}
    for r in made.results:
        for key, number in r.numbers.items():
            assert values[r.method, *key] == number.value
    assert (tmp_path / "out/evaluation.tex").read_text().startswith(r"\begin{table*}")
    page = (tmp_path / "out/evaluation.md").read_text()
    assert "What each number is" in page
    assert "simulated people" in {r["data_set"] for r in table.to_pylist()}
    assert_says(posegaussian("evaluate", *archive.options, "--methods", "nerf", cwd=tmp_path), "no method 'nerf'")
    assert_says(posegaussian("evaluate", *archive.options, "--measures", "vmaf", cwd=tmp_path), "no measure 'vmaf'")
