"""Pictures are drawn with the weights of every training, once, and stand in its table and in the paper's form."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from posegaussian.dags.ablation.cells import cell, take
from posegaussian.dags.ablation.driver import AblationOrder, plan_lines
from posegaussian.dags.ablation.groups import DRAWN, FOOTAGE, PICTURES, Row, SimulatedFootage, groups
from posegaussian.dags.ablation.paper_form import NOT_RUN, OURS, paper_form
from posegaussian.dags.ablation.tables import report
from posegaussian.dags.ablation.trained_runs import drawn_row, lpips_settings, picture_run, picture_runs, ring
from posegaussian.dags.paper.printed import ablation
from posegaussian.stages.network.card import SHIPPED
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.model.errors import ConfigError

CONFIG = TrainingConfig(depth_steps=4, joint_steps=2, iterations=3)
EVERY = {g.name: g for g in groups(CONFIG)}


@pytest.fixture(autouse=True)
def _surroundings(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Small sequences; a run sets threads through the environment."""
    monkeypatch.setitem(FOOTAGE, PICTURES, SimulatedFootage(1, 2.0, 48))
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


def finished(folder: Path, row: Row, seed: int = 0, file: Path = SHIPPED / "fast.safetensors") -> None:
    """A training that found something, with weights that ship."""
    trained = cell(CONFIG, row, seed, folder).folder
    trained.mkdir(parents=True)
    shutil.copy(file, trained / "weights.safetensors")
    found = {"steps": 6, "numbers": {"epe": 1.5, "1px": 0.75}, "parameters": 10, "minutes": 1.0, "machine": "none"}
    (trained / "result.json").write_text(json.dumps(found))


def test_every_row_is_drawn_once_and_rows_of_one_training_but_another_t_each_for_themselves(tmp_path: Path) -> None:
    chosen = [EVERY["pose"], EVERY["iterations"], EVERY["tps"]]
    names = [str(c) for c in picture_runs(CONFIG, chosen, (0, 1), tmp_path)]
    assert len(set(names)) == len(names) == 2 * (4 + 2)
    assert "pictures=default,T=1, seed 0" in names
    assert "pictures=default,T=3, seed 0" not in names, "the most that is trained is the row that all tables share"
    assert picture_runs(CONFIG, [EVERY["tps"]], (0,), tmp_path) == []
    assert drawn_row(CONFIG, EVERY["pose"].row("both")).label == "default"


@pytest.mark.parametrize(("cameras", "expected"), [((4, 16), 6), ((8, 12), 8), ((9, 16), 10)])
def test_neighbours_stand_no_farther_apart_than_was_trained(cameras: tuple[int, ...], expected: int) -> None:
    assert ring(CONFIG.model_copy(update={"cameras": cameras})) == expected


def test_pictures_stand_beside_what_the_training_says_and_are_drawn_once(tmp_path: Path) -> None:
    row, said = EVERY["encoders"].rows[0], list[str]()
    finished(tmp_path, row)
    take(tmp_path, CONFIG)
    order = AblationOrder(CONFIG, tmp_path, (0,), ("encoders",), workers=0, device="cpu", minutes=None)
    lines = plan_lines(order)
    assert "pictures=default, seed 0: not run, with weights default, seed 0" in lines
    assert "pictures=residual=False, seed 0: not run, after its training" in lines
    job = picture_run(CONFIG, row, 0, tmp_path)
    from posegaussian.dags.ablation.driver import _Work

    work = _Work(order, said.append, None)  # type: ignore[arg-type]
    work.do([job])
    assert not work.failures, work.failures
    assert not [f for f in (tmp_path / "sequences").iterdir() if f.suffix != ".lock"]
    stamp = (tmp_path / "runs" / "pictures=default" / "seed-0" / "result.json").stat().st_mtime_ns
    work.do([job])
    assert (tmp_path / "runs" / "pictures=default" / "seed-0" / "result.json").stat().st_mtime_ns == stamp
    found = report(CONFIG, tmp_path, [0], {})
    rows = {r["label"]: r for g in found["groups"] if g["name"] == "encoders" for r in g["rows"]}
    measures = rows[row.label]["measures"]
    assert {"epe", "1px", *DRAWN} - set(measures) == {"lpips box", "lpips full"}, "LPIPS needs its files"
    text = "\n".join(paper_form({g["name"]: g for g in found["groups"]}))
    psnr = f"{measures['psnr full']['mean']:.4g}"
    assert f"| {row.label} | {psnr}*" in text, "of one seed, no claim"
    trained = cell(CONFIG, row, 0, tmp_path).folder / "weights.safetensors"
    trained.write_bytes(trained.read_bytes() + b"\0")  # trained anew
    assert job.result() is None


def test_what_is_not_trained_is_said_and_not_drawn(tmp_path: Path) -> None:
    said: list[str] = []
    take(tmp_path, CONFIG)
    order = AblationOrder(CONFIG, tmp_path, (0,), ("heads",), workers=0, device="cpu")
    job = picture_run(CONFIG, EVERY["heads"].rows[0], 0, tmp_path)
    from posegaussian.dags.ablation.driver import _Work

    _Work(order, said.append, None).do([job])  # type: ignore[arg-type]
    assert said == ["pictures=default, seed 0: its training is not finished, so nothing can be drawn with it"]


def test_lpips_is_asked_for_by_its_files_and_what_was_run_without_is_run_again(tmp_path: Path) -> None:
    files = tmp_path / "alex.pth", tmp_path / "linear.pth"
    with pytest.raises(ConfigError, match=r"--lpips: no file .*alex\.pth"):
        lpips_settings(files)
    for file in files:
        file.write_bytes(b"x")
    metrics = lpips_settings(files)
    assert lpips_settings(None) == ()
    assert '"lpips_alex"' in metrics[0]
    row = EVERY["pose"].row("both")
    finished(tmp_path, row)
    plain, (with_lpips,) = (
        picture_run(CONFIG, row, 0, tmp_path),
        [c for c in picture_runs(CONFIG, [EVERY["pose"]], (0,), tmp_path, metrics) if c.row.label == "default"],
    )
    from posegaussian.dags.ablation.pipeline_runs import own_weights

    weights = own_weights(plain)
    assert weights is not None
    plain.note(weights, {"psnr full": 30.0})
    assert plain.finished(weights)
    assert not with_lpips.finished(weights)
    with_lpips.note(weights, {"psnr full": 30.0, "lpips full": 0.1})
    assert plain.finished(weights)
    assert with_lpips.finished(weights)


def test_the_papers_form_has_its_tables_and_says_what_was_not_run(tmp_path: Path) -> None:
    found = report(CONFIG, tmp_path, [0], {})
    lines = paper_form({g["name"]: g for g in found["groups"]})
    titles = [line for line in lines if line.startswith("## ")]
    assert [t.split(",")[0] for t in titles[:5]] == [
        "## Table 1",
        "## Table 2",
        "## Table 3",
        "## Section 4.2",
        "## Table 4",
    ]
    body = [line for line in lines if line.startswith("| ") and "---" not in line]
    assert sum(NOT_RUN in line for line in body) == len(body) - len(titles), "every row but the heads"
    text = "\n".join(lines)
    assert f"{NOT_RUN} (30.86)" in text
    loss = lines[lines.index("## Table 4, loss hyperparameters") + 2 :]
    rows = [[c.strip() for c in line.split("|")[1:-1]] for line in loss[:9] if line.startswith("| ")][2:]
    assert rows[0] == ["0.5", "0.5", "0", *(f"{NOT_RUN} ({n})" for n in ("19.9", "0.879", "0.205"))]
    assert len({tuple(r[:3]) for r in rows}) == len(rows), "a training stands once"
    printed = {m for p in ablation().values() for m in p.measures} - {
        "parameters",
        "mean change of SSIM",
        "its deviation",
    }
    assert printed <= set(OURS)
