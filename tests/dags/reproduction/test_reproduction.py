"""The paper's tables come out in its form, with what was measured here beside what it prints, and nothing made up."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest

from posegaussian.dags.ablation.groups import SimulatedFootage
from posegaussian.dags.ablation.tables import report
from posegaussian.dags.compiling.warm_up import steady_seconds
from posegaussian.dags.evaluation.evaluate import PATHS, evaluate
from posegaussian.dags.evaluation.methods import OURS, chosen
from posegaussian.dags.evaluation.results import SIMULATED, data_set
from posegaussian.dags.evaluation.spent import receipts, told
from posegaussian.dags.paper.printed import ablation, table
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.reproduction import ablated, reproduce
from posegaussian.dags.reproduction.page import NOT_RUN, Page, markdown
from posegaussian.dags.reproduction.people import FILMED, SEEDS, Wanted, in_archive
from posegaussian.dags.reproduction.runtime import REST, SPLATTING, WHOLE, lines
from posegaussian.dags.training.config import load_training
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import ArchiveError, ConfigError
from tests.dags.cli.test_cli import assert_says, posegaussian
from tests.dags.tradeoff.test_tradeoff import files
from tests.support.pipeline import NAME, Pipeline

METHODS = f"{OURS},hull,pose_off"
SMALL = Wanted("people8", SimulatedFootage(1, 2.0, 48), 8)
EMPTY = {g["name"]: g for g in report(load_training(None, []), Path("none"), [0], {})["groups"]}


def order(name: str, output: Path, globs: tuple[str, ...] = ()) -> reproduce.Order:
    return reproduce.Order(name, globs, chosen(METHODS), None, output)


@pytest.fixture(scope="module")
def second(finished: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Pipeline, Page, Path]]:
    """Table 2 of an archive with one simulated person of 6 cameras; those of 8 are filmed, smaller than usual."""
    folder = tmp_path_factory.mktemp("reproduced")
    archive = finished.copy(folder / "archive")
    with pytest.MonkeyPatch.context() as patch:
        compared = reproduce.COMPARED["table2"]
        patch.setitem(reproduce.COMPARED, "table2", replace(compared, wanted=(compared.wanted[0], SMALL)))
        page = reproduce._compared(archive.session, order("table2", folder / "out"))
        assert page is not None
        yield archive, page, folder / "out"


def rows(page: Page, part: int = 0) -> dict[str, list[str]]:
    return {row[0]: row[1:] for row in page.parts[part].body}


def test_the_papers_rows_stand_as_it_prints_them_and_ours_as_they_were_measured(second: tuple) -> None:
    archive, page, _ = second
    found = rows(page)
    assert found["Ours"][:6] == ["24.9", "0.94", "0.09", "26.07", "0.927", "0.081"]
    assert found["GPS-Gaussian [CVPR'24]"][:3] == ["23.03", "0.884", "0.168"]
    ours = evaluate(archive.session, [NAME], chosen(OURS)).results[0]
    for region in ("full", "box"):
        psnr, ssim = (ours.numbers[m, region, "mean"].value for m in ("psnr", "ssim"))
        cells = found[f"here: {OURS} on {SIMULATED}, {region}"]
        assert cells[:3] == [f"{psnr:.2f}", f"{ssim:.3f}", "-"], "LPIPS has no weights here"
        assert float(cells[3]) > 0, "of the people that were filmed with 8 cameras"
    blind = evaluate(archive.session, [NAME], chosen("pose_off")).results[0]
    cells = found[f"here: pose_off on {SIMULATED}, box"]
    assert cells[0] == f"{blind.numbers['psnr', 'box', 'mean'].value:.2f}"
    assert set(found["here: THuman2.0"]) == {NOT_RUN}
    told = "\n".join(page.told)
    assert "Not comparable: these with the paper's" in told
    assert "THuman2.0: not run, the archive has no such sequence" in told
    assert "8 source views, 1 frames) of people8-0" in told, "whatever cameras the user holds out of other sequences"


def test_a_second_call_films_and_computes_nothing_and_says_the_same(second: tuple) -> None:
    archive, page, output = second
    assert (output / FILMED / f"people8-{SEEDS[0]}").is_dir()
    before = files(archive.root), files(output)
    again = reproduce._compared(archive.session, order("table2", output))
    assert again is not None
    assert markdown(again) == markdown(page)
    for old, new in zip(before, (files(archive.root), files(output)), strict=True):
        assert {k for k in new if "_receipts" in k} == {k for k in old if "_receipts" in k}
        assert all(new[k] == v for k, v in old.items() if "_receipts" in k or "/c." in k or "_captures" in k)


def test_simulated_people_of_the_archive_are_taken_before_any_are_filmed(second: tuple, tmp_path: Path) -> None:
    archive, _, _ = second
    page = reproduce._compared(archive.session, order("table1", tmp_path))
    assert page is not None
    assert not (tmp_path / FILMED).exists()
    assert [p.title for p in page.parts] == [*table("table1").rows, SIMULATED]
    zju, people = rows(page), rows(page, -1)
    assert zju["Ours"] == ["30.86", "0.979", "0.028", "30m / 100"]
    assert set(zju["here: ZJU-MoCap"]) == {NOT_RUN}
    assert people["Ours on HuMMan"] == ["22.18", "0.977", "0.060", "-"]
    assert f"here: {OURS}, box" in people


def test_a_sequence_of_a_data_set_stands_beside_the_papers_numbers_of_it(second: tuple, tmp_path: Path) -> None:
    """The record knows it: from the layout, or by its name where the layout says nothing, as of scans."""
    archive, _, _ = second
    capture = archive.context().capture
    assert data_set(capture) == SIMULATED
    told = replace(capture, data_set="Twindom")
    assert data_set(told) == data_set(Capture.from_json(json.loads(json.dumps(told.to_json())))) == "Twindom"
    assert data_set(replace(capture, layout="zju_mocap", depth=())) == "ZJU-MoCap"
    assert capture.to_json().keys() == told.to_json().keys() - {"data_set"}, "records of before stay as they were"


def test_an_archive_that_is_not_there_has_no_sequences_unless_some_are_asked_for(tmp_path: Path) -> None:
    session = Pipeline(tmp_path / "none", tmp_path).session
    assert in_archive(session, (), ("ZJU-MoCap",)) == ([], [])
    with pytest.raises(ArchiveError):
        in_archive(session, ("walk",), ("ZJU-MoCap",))


def receipt(stage: str, seconds: float, **modules: float) -> SimpleNamespace:
    named = {name.replace("_", " "): s for name, s in modules.items()}
    return SimpleNamespace(stage=stage, facts={"seconds": seconds, "modules": named})


def test_every_millisecond_of_a_frame_is_in_one_of_the_papers_lines() -> None:
    of = [
        receipt("survey", 50.0),
        receipt("frames", 1.0),
        receipt("smoothing", 2.0),
        receipt("network", 8.0, pose_encoder=1.0, image_encoder=2.0, refinement=3.0),
        receipt("rendering", 6.0),
    ]
    found = lines(of, frames=4, pictures=12)  # type: ignore[arg-type]
    five = {k: found[k] for k in table("runtime").rows}
    assert list(five.values()) == pytest.approx([500, 250, 500, 500, 1500, 3250])
    assert sum(ms for line, ms in found.items() if line.startswith("of the rest")) == pytest.approx(found[REST])
    assert found["once a sequence: survey"] == pytest.approx(50_000), "no part of a frame"


def test_what_a_process_spends_once_is_no_time_of_a_frame() -> None:
    first, later = receipt("depth", 40.0), receipt("depth", 2.0)
    first.facts["warm_up"], later.facts["warm_up"] = 38.0, 0.0
    found = [lines([r], frames=1, pictures=1) for r in (first, later)]  # type: ignore[list-item]
    assert found[0] == found[1]
    assert "but in tasks of a version" not in told([first, later])  # type: ignore[list-item]
    assert lines([receipt("depth", 40.0)], frames=1, pictures=1)[WHOLE] == 40_000  # type: ignore[list-item]
    assert "but in tasks of a version" in told([receipt("depth", 40.0)])  # type: ignore[list-item]


def test_a_sequence_that_cannot_be_read_is_named_and_the_others_are_measured(second: tuple, tmp_path: Path) -> None:
    archive = second[0].copy(tmp_path / "archive")
    shutil.copytree(archive.root / NAME, archive.root / "other")
    bad = archive.with_settings("sequences={other: {views: {held_out: [camXX]}}}").session
    found, refused = in_archive(bad, (), (SIMULATED,))
    assert [s.name for s in found] == [NAME]
    (sentence,) = refused
    assert sentence.startswith("other: ")
    assert "camXX" in sentence
    page = reproduce._compared(bad, replace(order("runtime", tmp_path), methods=chosen(OURS)))
    assert page is not None
    assert page.status == 1
    assert any(NAME in column for column in page.parts[0].head)


def test_runtime_is_what_the_receipts_say(second: tuple, tmp_path: Path) -> None:
    archive, _, _ = second
    own = replace(order("runtime", tmp_path), methods=chosen(OURS))
    page = reproduce._compared(archive.session, own)
    assert page is not None
    (part,) = page.parts
    assert [row[:2] for row in part.body[:6]] == [[k, v["ms"]] for k, v in table("runtime").rows.items()]
    of = receipts(archive.session.plan(NAME, Selection(), PATHS))
    drawing = sum(steady_seconds(r.facts) for r in of if r.stage == "rendering")
    values = {r["row"]: r["value"] for r in part.records if r["source"] == "here"}
    assert values[SPLATTING] == pytest.approx(1000 * drawing / 6, rel=0.01)
    five = [values[k] for k in table("runtime").rows if k != WHOLE]
    assert values[WHOLE] == pytest.approx(sum(five), rel=0.02)
    assert "without the network" in "\n".join(page.told)


def test_what_an_ablation_found_stands_in_table_4_and_figure_5(tmp_path: Path) -> None:
    groups = json.loads(json.dumps(EMPTY))
    row = next(r for r in groups["lambda"]["rows"] if r["label"].endswith("lambda 1"))
    row["measures"]["psnr full"] = {"mean": 27.125, "error": 0.25, "count": 3}
    (tmp_path / "ablation.json").write_text(json.dumps({"groups": list(groups.values())}))
    page = ablated.table4(*ablated.groups_of(tmp_path))
    assert ["0.5", "0.5", "1", "27.12 ± 0.25 (24.9)", f"{NOT_RUN} (0.940)", f"{NOT_RUN} (0.090)"] in page.parts[0].body
    values = [(r["source"], r["value"]) for r in page.parts[0].records if r["row"] == row["label"]]
    assert ("here", 27.12) in values
    assert ("paper", 24.9) in values
    left, right = ablated.fig5(*ablated.groups_of(tmp_path)).parts
    assert ["both", NOT_RUN, NOT_RUN, f"{NOT_RUN} (0.09)"] in left.body
    assert len(right.body) == 4


def test_without_an_ablation_the_command_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = ablated.table4(*ablated.groups_of(None))
    assert "`posegaussian ablate --only beta_gamma,lambda`" in "\n".join(page.told)
    assert all(cell.startswith(NOT_RUN) for row in page.parts[0].body for cell in row[3:])
    assert len(ablated.stabilizer_rows(ablated.groups_of(None)[0])) == 2
    with pytest.raises(ConfigError, match=r"--ablation nowhere: .*name the folder of its --output"):
        ablated.groups_of(Path("nowhere"))
    (tmp_path / "ablation.json").write_text('{"groups": []}')
    with pytest.raises(ConfigError, match=r"lacks the groups .*lambda"):
        ablated.groups_of(tmp_path)


def test_every_number_of_the_paper_is_a_number_and_stands_once() -> None:
    """But `30m / 100`, `about 1.1` and the like, which are printed so."""
    of_methods = [row for rows in table("table1").rows.values() for row in rows.values()]
    of_methods += [row for setups in table("table2").rows.values() for row in setups.values()]
    for row in (*of_methods, *table("table3").rows.values(), *table("runtime").rows.values()):
        assert row
        for column, text in row.items():
            assert column == "Train/FPS" or float(text) > 0
    ours = table("table2").rows["Ours"]
    assert [ablation()["cameras"].rows[f"{n} cameras"] for n in (6, 8)] == [ours["6 cameras"], ours["8 cameras"]]
    five = [float(v["ms"]) for line, v in table("runtime").rows.items() if line != WHOLE]
    assert sum(five) == float(table("runtime").rows[WHOLE]["ms"])


def test_the_command_writes_three_files_and_refuses_what_cannot_be(second: tuple, tmp_path: Path) -> None:
    archive, _, _ = second
    options = [*archive.options, "--paper", "table3", "--methods", OURS, "--output", "out"]
    done = posegaussian("evaluate", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("next: posegaussian evaluate")
    found = pq.read_table(tmp_path / "out/table3.parquet")
    assert found.schema.metadata[b"label"].decode() == table("table3").label
    told = [r for r in found.to_pylist() if r["source"] == "here"]
    assert {r["region"] for r in told} == {"full", "box"}
    assert all(r["definition"] for r in found.to_pylist())
    tex = (tmp_path / "out/table3.tex").read_text()
    page = (tmp_path / "out/table3.md").read_text()
    for r in found.to_pylist():
        assert r["text"] in tex
        assert r["text"] in page
    assert_says(posegaussian("evaluate", "--paper", "table9", cwd=tmp_path), "table9", "table1, table2, table3")
    assert_says(
        posegaussian("evaluate", "--paper", "runtime", "--methods", "hull", cwd=tmp_path), "our own method alone"
    )
    assert_says(posegaussian("evaluate", "--ablation", "x", cwd=tmp_path), "goes with --paper")
