"""Rows of an ablation that are runs of the pipeline: filmed once, run once, gone on with after a kill, compared with
equal weights alone."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.dags.ablation.cells import take
from posegaussian.dags.ablation.driver import AblationOrder, ablate, plan_lines
from posegaussian.dags.ablation.groups import FOOTAGE, SimulatedFootage, groups
from posegaussian.dags.ablation.measures import pictures
from posegaussian.dags.ablation.pipeline_runs import RunCell, Weights, run, runs_in_order, weights_of
from posegaussian.dags.ablation.tables import page, report
from posegaussian.stages.network.card import SHIPPED
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.model.errors import ConfigError, UserError

CONFIG = TrainingConfig(depth_steps=4, joint_steps=2, iterations=3)
TINY = {
    "tps": SimulatedFootage(3, 30.0, 48, 4, {"joint_noise": {"pixels": 1.0, "dropouts": 0.1, "outliers": 0.0}}),
    "cameras": SimulatedFootage(1, 2.0, 48),
}
METHODS = ("off", "pairwise", "recurrent", "adaptive")


@pytest.fixture(autouse=True)
def _surroundings(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Small sequences; a run sets threads through the environment."""
    for name, footage in TINY.items():
        monkeypatch.setitem(FOOTAGE, name, footage)
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


def group(name: str) -> Any:
    return next(g for g in groups(CONFIG) if g.name == name)


def cells(name: str, folder: Path, seeds: tuple[int, ...] = (0,)) -> dict[tuple[str, int], RunCell]:
    return {(c.row.label, c.seed): c for c in runs_in_order([group(name)], seeds, folder)}


def order(folder: Path, *only: str, **more: Any) -> AblationOrder:
    return AblationOrder(CONFIG, folder, (0,), only, workers=0, device="cpu", **more)


def done(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "ablation.json").read_text())
    return {g["name"]: {r["label"]: r for r in g["rows"]} for g in found["groups"]}


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Both groups with a seed, ended after three tasks and gone on with."""
    folder, said = tmp_path_factory.mktemp("ran"), list[str]()
    with pytest.MonkeyPatch.context() as m:
        for name, footage in TINY.items():
            m.setitem(FOOTAGE, name, footage)
        take(folder, CONFIG)
        left = iter(range(4))
        first = runs_in_order([group("tps")], (0,), folder)[0]
        assert not run(first, weights_of(None, CONFIG, 0, folder), 1, said.append, lambda: next(left, None) is not None)
        assert first.state() == "not run"
        assert (first.sequence / "capture").is_dir()
        assert ablate(order(folder, "tps", "cameras"), said.append)
    return folder, said


def test_a_run_that_was_cut_off_goes_on_and_films_nothing_twice(ran: tuple[Path, list[str]]) -> None:
    folder, said = ran
    filmed = [line.strip() for line in said if "filming" in line]
    assert filmed == [
        "filming 3 frames of seed 8000, throw, with 4 cameras and 2 held out",
        "filming 1 frame of seed 8000, throw, with 8 cameras and 2 held out",
        "filming 1 frame of seed 8000, throw, with 6 cameras and 2 held out",
    ]
    assert not [f for f in (folder / "sequences").iterdir() if f.suffix != ".lock"], (
        "what all rows are through with is removed"
    )


def test_every_row_says_what_its_table_shows(ran: tuple[Path, list[str]]) -> None:
    tables = done(ran[0])
    for name, labels in (("tps", METHODS), ("cameras", ("6 cameras", "8 cameras"))):
        for label in labels:
            row = tables[name][label]
            assert (row["seeds"], row["claim"]) == (1, False)
            known = {m for m in group(name).shown if m in row["measures"]}
            assert {"psnr box", "ssim box", "epe"} <= known
            assert all(np.isfinite(row["measures"][m]["mean"]) for m in known)
            assert set(row["against_reference"]) == (set() if label == group(name).reference else known)
    numbers = {label: tables["tps"][label]["cells"][0]["numbers"] for label in METHODS}
    assert len({n["jitter"] for n in numbers.values()}) == 4, "every filter makes other heatmaps"
    assert numbers["pairwise"]["jitter"] < numbers["off"]["jitter"]
    assert {"change of ssim", "its deviation"} <= set(numbers["off"])
    assert tables["tps"]["pairwise"]["pipeline"] == ["effects.temporal_smoothing=on", "smoothing.method=pairwise"]
    text = (ran[0] / "ablation.md").read_text()
    assert "the seed counted from 8000: 3 frames at 30 a second, 48 px, 2 held-out views" in text
    assert "Weights fast (sha256 " in text
    assert "| against off " in text
    assert "1, no claim" in text


def test_what_is_finished_is_not_run_again(ran: tuple[Path, list[str]]) -> None:
    folder, said = ran[0], list[str]()
    before = {f: f.stat().st_mtime_ns for f in folder.glob("runs/**/result.json")}
    assert len(before) == 6
    assert plan_lines(order(folder, "tps", "cameras"))[-1] == "0 runs to do, 6 done"
    assert ablate(order(folder, "tps", "cameras"), said.append)
    assert {f: f.stat().st_mtime_ns for f in before} == before
    assert not [line for line in said if line.startswith("cell ")]


def test_other_weights_or_another_sequence_are_run_anew(
    ran: tuple[Path, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = runs_in_order([group("tps")], (0,), ran[0])[0]
    weights = weights_of(None, CONFIG, 0, ran[0])
    assert first.finished(weights)
    assert not first.finished(Weights("fast", "fast", "0" * 64, weights.iterations))
    assert not first.finished(Weights("fast", "fast", weights.sha256, 1))
    monkeypatch.setitem(FOOTAGE, "tps", SimulatedFootage(4, 30.0, 48))
    assert not runs_in_order([group("tps")], (0,), ran[0])[0].finished(weights)


def test_rows_count_with_the_weights_of_their_reference_alone(tmp_path: Path) -> None:
    old, new = (Weights("fast", name, digest * 64, 3) for name, digest in (("old", "0"), ("new", "1")))
    every = cells("tps", tmp_path, (0, 1, 2))
    for (label, seed), c in every.items():
        c.note(old, {"psnr box": 30.0 + seed + (label != "off") * 0.1 * seed, "epe": 1.0, "lag": None})
    rows = {
        r["label"]: r
        for g in report(CONFIG, tmp_path, [0, 1, 2], {})["groups"]
        if g["name"] == "tps"
        for r in g["rows"]
    }
    assert rows["pairwise"]["claim"]
    assert rows["pairwise"]["measures"]["psnr box"]["mean"] == pytest.approx(31.1)
    against = rows["pairwise"]["against_reference"]
    assert against["psnr box"]["mean"] == pytest.approx(0.1), "seed by seed: how sequences differ is not in it"
    assert against["psnr box"]["error"] == pytest.approx(0.1 / 3**0.5)
    assert "lag" not in rows["pairwise"]["measures"]
    every["off", 2].note(new, {"psnr box": 35.0, "epe": 1.0})
    found = report(CONFIG, tmp_path, [0, 1, 2], {})
    rows = {r["label"]: r for g in found["groups"] if g["name"] == "tps" for r in g["rows"]}
    assert (rows["off"]["seeds"], rows["pairwise"]["seeds"], rows["pairwise"]["claim"]) == (3, 2, False)
    assert rows["pairwise"]["cells"][2]["state"] == "run with other weights than off"
    text = "\n".join(page(found))
    assert "Weights old (sha256 000000000000): seeds 0, 1. Weights new (sha256 111111111111): seed 2." in text
    assert "| 0.023" in text


def test_weights_are_those_named_else_the_trained_default_else_what_ships(tmp_path: Path) -> None:
    shipped = weights_of(None, CONFIG, 0, tmp_path)
    assert (shipped.setting, shipped.name, shipped.iterations) == ("fast", "fast", 4)
    trained = tmp_path / "cells" / "default" / "seed-0"
    trained.mkdir(parents=True)
    shutil.copy(SHIPPED / "fast.safetensors", trained / "weights.safetensors")
    assert weights_of(None, CONFIG, 0, tmp_path).setting == "fast", "not finished yet"
    (trained / "result.json").write_text("{}")
    found = weights_of(None, CONFIG, 0, tmp_path)
    assert (Path(found.setting), found.name) == (trained / "weights.safetensors", "default, seed 0")
    assert weights_of(None, CONFIG, 1, tmp_path).setting == "fast"
    named = tmp_path / "mine.safetensors"
    shutil.copy(SHIPPED / "fast.safetensors", named)
    assert weights_of(str(named), CONFIG, 0, tmp_path).setting == str(named)
    assert weights_of("fast", CONFIG, 0, tmp_path).setting == "fast"
    with pytest.raises(ConfigError, match=r"network.weights is fastest: neither weights that ship"):
        ablate(order(tmp_path / "x", "tps", weights="fastest"), print)


def test_there_is_one_sequence_a_seed_and_no_more(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--seeds 1000: there are 1000 sequences for validation"):
        plan_lines(AblationOrder(CONFIG, tmp_path, (1000,), ("cameras",)))
    with pytest.raises(ConfigError, match="--no-pictures"):
        plan_lines(AblationOrder(CONFIG, tmp_path, (1000,), ("heads",)))
    assert plan_lines(AblationOrder(CONFIG, tmp_path, (1000,), ("heads",), pictures=False))
    assert [c.scene.seed for c in runs_in_order([group("cameras")], (0, 5), tmp_path)] == [8000, 8000, 8005, 8005]


def test_runs_go_seed_by_seed_and_the_reference_comes_first(tmp_path: Path) -> None:
    assert [str(c) for c in runs_in_order(groups(CONFIG), (3, 1), tmp_path)][:5] == [
        "tps=off, seed 3",
        "tps=pairwise, seed 3",
        "tps=recurrent, seed 3",
        "tps=adaptive, seed 3",
        "tps=off, seed 1",
    ]
    assert [str(c) for c in runs_in_order([group("cameras")], (0,), tmp_path)] == [
        "cameras=8, seed 0",
        "cameras=6, seed 0",
    ]


def test_a_second_ablation_of_the_same_sequence_is_refused(tmp_path: Path) -> None:
    from posegaussian.dags.training.run_folder import locked

    first = runs_in_order([group("tps")], (0,), tmp_path)[0]
    with (
        locked(first.sequence.with_suffix(".lock"), "taken"),
        pytest.raises(UserError, match="another ablation is at work"),
    ):
        run(first, weights_of(None, CONFIG, 0, tmp_path), 1, print, lambda: True)


def test_a_run_that_fails_is_said_and_the_next_one_begins(tmp_path: Path) -> None:
    first = runs_in_order([group("cameras")], (0,), tmp_path)
    for c in first:  # filmed, it seems, but there is nothing
        c.sequence.mkdir(parents=True)
        (c.sequence / "sequence.json").write_text(
            json.dumps({"scene": c.scene.model_dump(mode="json"), "held_out": "views.held_out=[]"})
        )
    said: list[str] = []
    assert ablate(order(tmp_path, "cameras"), said.append) is False
    for c in first:
        assert any(line.startswith(f"{c}: ") for line in said)
        assert f"Failed: {c}: " in (tmp_path / "ablation.md").read_text()


def test_minutes_end_the_runs_in_order(tmp_path: Path) -> None:
    said: list[str] = []
    assert ablate(order(tmp_path, "tps", minutes=0.0), said.append)
    assert "the minutes are over, 4 cells of 4 are left; the same command goes on from here" in said
    assert not list(tmp_path.glob("sequences/*"))


def test_the_change_of_ssim_is_taken_over_each_cameras_frames() -> None:
    def rows() -> Iterator[dict[str, Any]]:
        for camera, changes in (("a", (0.1, 0.3)), ("b", (0.5, 0.5))):
            about = {"camera": camera, "definition": "as it is"}
            for value in changes:
                yield {**about, "region": "box", "measure": "delta_ssim", "value": value}
                yield {**about, "region": "full", "measure": "delta_ssim", "value": 9.0}
                yield {**about, "region": "box", "measure": "psnr", "value": 20.0 + value}

    path = SimpleNamespace(kind="held_out", name="held_out-0")
    results = SimpleNamespace(
        context=SimpleNamespace(paths={path.name: path}), table=lambda template, name: list(rows())
    )
    found = pictures(results)  # type: ignore[arg-type]
    assert found == pytest.approx(
        {"psnr box": 20.35, "change of ssim": 0.35, "its deviation": 0.05}
    )  # deviations 0.1 and 0
