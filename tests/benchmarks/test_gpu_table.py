"""The table of `make gpu` on a machine without a GPU: every part runs, small, and no figure of it is told; what fails
is told, and takes nothing along."""

from __future__ import annotations

import json
import sys
import types
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
import torch

from benchmarks.gpu import part, renderer, table, tests, training
from benchmarks.gpu.rows import UNMEASURED, Row, Setup
from posegaussian.dags.training.config import load_training
from tests.support.gaussian_scenes import NO_GPU

SMALL = Setup(torch.device("cpu"))
without_a_device = pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")


def figures(rows: list[Row]) -> set[float | str]:
    return {row.figure for row in rows}


@pytest.mark.skipif(NO_GPU is not None, reason=str(NO_GPU))
@without_a_device
def test_the_renderer_runs_in_the_interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renderer, "SIZES", (1024,))
    large, larger = (renderer.backend.Shape(tile, 32) for tile in (32, 64))  # few programs: each takes as long
    monkeypatch.setattr(renderer, "SHAPES", (large, larger))
    monkeypatch.setattr(renderer.backend, "SHAPE", large)
    rows = list(part.rows("renderer", SMALL))
    assert not any(row.wrong for row in rows)
    assert figures(rows) == {UNMEASURED, "gsplat is not installed"}
    assert {row.size for row in rows} == {"1024 px"}
    assert sum("a picture and its gradients" in row.what for row in rows) == 2


@pytest.mark.parametrize("name", ["renderer", "refinement"])
def test_without_triton_a_part_says_so(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renderer.backend, "triton_version", lambda: None)
    (row,) = part.rows(name, SMALL)
    assert str(row.figure).startswith(f"{UNMEASURED}: Triton is not installed")
    assert not row.wrong


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("network", "network fast, bf16: a pair"),
        pytest.param(
            "refinement", "refinement: steps", marks=pytest.mark.skipif(NO_GPU is not None, reason=str(NO_GPU))
        ),
        ("frame", "a frame: rendering"),
    ],
)
def test_every_other_part_runs_small(name: str, row: str) -> None:
    rows = list(part.rows(name, SMALL))
    assert figures(rows) == {UNMEASURED}
    assert row in {r.what for r in rows}


def test_a_small_training_is_a_training_of_two_steps() -> None:
    words = training.command(SMALL, Path("somewhere"))
    config = load_training(None, [b for a, b in pairwise(words) if a == "--set"])
    assert config.steps == 2
    assert "--minutes" not in words
    assert list(part.rows("training", SMALL)) == [Row("training", "", "not asked for (MINUTES=0)")]


def test_figures_count_on_a_device_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """What broke is told on every machine."""
    given = [Row("a", "1 px", 2.0, "ms", "it"), Row("b", "", "not installed"), Row("c", "", 3.0, "", wrong=True)]
    module = types.ModuleType("benchmarks.gpu.renderer")
    module.rows = lambda setup: iter(given)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    assert list(part.rows("renderer", SMALL)) == [Row("a", "1 px", UNMEASURED), *given[1:]]
    assert list(part.rows("renderer", Setup(torch.device("cuda")))) == given


def test_what_a_part_raises_ends_it_with_a_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def rows(setup: Setup) -> Iterator[Row]:
        yield Row("a")
        raise RuntimeError("the device is gone\nmore of it")

    module = types.ModuleType("benchmarks.gpu.renderer")
    module.rows = rows  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    assert list(part.rows("renderer", SMALL))[1].figure == "failed: RuntimeError: the device is gone"


@pytest.mark.parametrize(
    ("code", "minutes", "says"),
    [("import os; os.abort()", 1.0, "its process ended with status -6"), ("while True: pass", 0.02, "ended after")],
)
def test_a_process_that_ends_keeps_its_rows_and_says_so(
    code: str, minutes: float, says: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    line = json.dumps({"what": "a", "figure": UNMEASURED})
    script = tmp_path / "python"
    script.write_text(f'#!{sys.executable}\nimport sys\nopen(sys.argv[4], "w").write({line!r} + chr(10))\n{code}\n')
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    kept, last = table.run("renderer", [], minutes)
    assert kept == Row("a", figure=UNMEASURED)
    assert last.wrong
    assert says in str(last.figure)


@without_a_device
def test_it_ends_with_the_table_and_writes_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """In processes, as `make gpu` does it."""
    monkeypatch.setattr(table, "RESULTS", tmp_path)
    monkeypatch.setattr("benchmarks.report.RESULTS", tmp_path)
    with pytest.raises(SystemExit) as ended:
        table.main(["--parts", "training", "--minutes", "0"])
    lines = capsys.readouterr().out.splitlines()
    assert ended.value.code == 0
    assert f"torch: {torch.__version__}" in "".join(lines)
    assert lines[-2] == "| training |  | not asked for (MINUTES=0) |  |  |"
    assert not list(tmp_path.iterdir())


def test_figures_are_written_with_what_they_belong_to(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(table, "RESULTS", tmp_path)
    monkeypatch.setattr("benchmarks.report.RESULTS", tmp_path)
    table.write([Row("a | b", "512 px", 1234.56, "ms", "a card")], {"CUDA device": "a card"}, {"repeats": 3})
    text = (tmp_path / table.FILE).read_text().splitlines()
    assert text[0].startswith("CUDA device: a card; processor: ")
    assert text[-1] == "| a / b | 512 px | 1,235 | ms | a card |"
    kept = json.loads((tmp_path / "gpu.json").read_text())
    assert kept["rows"] == [{"what": "a | b", "size": "512 px", "figure": 1235.0, "unit": "ms", "on": "a card"}]
    assert kept["settings"] == {"repeats": 3, "CUDA device": "a card"}


def test_counts_of_tests_are_told_from_the_report(tmp_path: Path) -> None:
    report = tmp_path / "tests.xml"
    report.write_text('<testsuites><testsuite tests="9" failures="1" errors="1" skipped="3"/></testsuites>')
    assert tests.told(report) == ("4 passed, 2 failed, 3 skipped", True)
    report.write_text('<testsuites><testsuite tests="9" failures="0" errors="0" skipped="0"/></testsuites>')
    assert tests.told(report) == ("9 passed", False)
