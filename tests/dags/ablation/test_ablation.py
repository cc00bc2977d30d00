"""An ablation trains each cell once and goes on where it ended; its tables say means, errors, and what was not run."""

from __future__ import annotations

import json
import math
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from posegaussian.dags.ablation.cells import PLAIN, cell, in_order, with_steps
from posegaussian.dags.ablation.driver import AblationOrder, ablate, plan_lines
from posegaussian.dags.ablation.groups import Row, groups
from posegaussian.dags.ablation.tables import NOT_RUN, page, report, spread
from posegaussian.dags.paper.printed import ablation
from posegaussian.dags.training.frame_producers import FrameError
from posegaussian.dags.training.state import packed, unpacked
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.archive.checkpoints import read_latest, steps_kept
from posegaussian.storage.model.errors import ConfigError
from tests.dags.training.test_training import PARTS

CONFIG = TrainingConfig(
    depth_steps=4, joint_steps=2, validate_every=100, checkpoint_every=3, window=2, steps_per_frame=4, iterations=3
)
EVERY = {g.name: g for g in groups(CONFIG)}


@pytest.fixture(autouse=True)
def _surroundings() -> Iterator[None]:
    """A training sets threads through the environment."""
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


def run(folder: Path, **more: Any) -> list[str]:
    said: list[str] = []
    order = AblationOrder(
        **{"config": CONFIG, "folder": folder, "seeds": (0,), "workers": 0, "device": "cpu", "pictures": False, **more}
    )
    ablate(order, said.append, PARTS)
    return said


def tables(folder: Path) -> dict[str, dict[str, Any]]:
    found = json.loads((folder / "ablation.json").read_text())
    return {g["name"]: {r["label"]: r for r in g["rows"]} for g in found["groups"]}


def cells(folder: Path) -> list[str]:
    return sorted(f"{f.parent.parent.name}/{f.parent.name}" for f in folder.glob("cells/*/seed-*/result.json"))


@pytest.fixture(scope="module")
def posed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where pose enters, with three seeds."""
    folder = tmp_path_factory.mktemp("posed")
    run(folder, only=("pose",), seeds=(0, 1, 2))
    return folder


def test_every_row_is_a_training_that_can_be_and_the_reference_is_one_of_them() -> None:
    assert list(EVERY) == [
        "fusion",
        "pose",
        "lambda",
        "beta_gamma",
        "iterations",
        "heads",
        "encoders",
        "tps",
        "cameras",
    ]
    for group in EVERY.values():
        assert group.row(group.reference)
        assert group.comparable.endswith(".")
        for row in group.rows:
            cell(CONFIG, row, 0, Path()).config.network()
    assert [r.iterations for r in EVERY["iterations"].rows] == [1, 2, 3]
    assert len(EVERY["fusion"].rows) == 7


def test_each_variant_of_the_encoders_changes_one_thing_and_is_another_network() -> None:
    shapes = [cell(CONFIG, row, 0, Path()).config.network() for row in EVERY["encoders"].rows]
    assert shapes[0] == CONFIG.network()
    changed = [{k for k, v in vars(s).items() if v != vars(shapes[0])[k]} for s in shapes[1:]]
    assert changed == [{"normalisation"}, {"residual"}, {"downsampling"}]


def test_the_paper_speaks_of_rows_that_there_are() -> None:
    assert list(ablation()) == list(EVERY)
    for name, printed in ablation().items():
        assert set(printed.rows) <= {r.label for r in EVERY[name].rows}, name
        assert printed.label


def test_what_is_equal_is_one_cell_and_the_cheapest_table_comes_first(tmp_path: Path) -> None:
    order = in_order(CONFIG, tuple(EVERY.values()), (0, 1), tmp_path)
    names = [(c.variant, c.config.seed) for c in order]
    assert len(set(names)) == len(names) == 2 * (1 + 2 + 3 + 3 + 3 + 3 + 6)
    assert names[:3] == [(PLAIN, 0), (PLAIN, 1), ("rotation_head=quaternion", 0)]
    assert names[-1] == ("fusion=outer", 1)
    assert names.index(("pose_in=none", 0)) < names.index(("fusion=attention", 0))


def test_a_variant_is_named_after_what_differs_from_the_configuration(tmp_path: Path) -> None:
    gated = CONFIG.model_copy(update={"fusion": "gated"})
    assert cell(gated, Row("gated", {"fusion": "gated"}), 3, tmp_path).variant == PLAIN
    other = cell(gated, Row("plain", {"fusion": "concatenation", "pose_fusion": 0.5}), 3, tmp_path)
    assert other.variant == "fusion=concatenation,pose_fusion=0.5"
    assert other.config.seed == 3
    assert other.folder == tmp_path / "cells" / other.variant / "seed-3"


def test_each_cell_is_trained_once_and_its_numbers_stand_in_the_table(posed: Path) -> None:
    assert cells(posed) == sorted(
        f"{v}/seed-{s}" for v in (PLAIN, "pose_in=none", "pose_in=depth", "pose_in=decoder") for s in (0, 1, 2)
    )
    rows = tables(posed)["pose"]
    for label, row in rows.items():
        assert (row["seeds"], row["claim"]) == (3, True)
        values = [c["numbers"]["epe"] for c in row["cells"]]
        logged = [
            json.loads(
                (posed / "cells" / c["variant"] / f"seed-{c['seed']}" / "log.jsonl").read_text().splitlines()[-1]
            )["epe"]
            for c in row["cells"]
        ]
        assert values == logged
        assert row["measures"]["epe"]["mean"] == pytest.approx(sum(values) / 3)
        assert row["measures"]["epe"]["error"] == pytest.approx(statistics.stdev(values) / math.sqrt(3))
        assert list(row["against_reference"]) == ([] if label == "both" else ["epe"])
    assert rows["neither"]["paper"] == {"LPIPS": "0.16"}


def test_what_is_finished_is_not_trained_again_even_without_its_checkpoints(posed: Path, tmp_path: Path) -> None:
    before = {
        f: f.stat().st_mtime_ns
        for f in posed.rglob("*")
        if f.is_file() and f.name not in ("ablation.json", "ablation.md", "ablation.yaml")
    }
    page_before = (posed / "ablation.md").read_text()
    run(posed, only=("pose",), seeds=(0, 1, 2))
    assert {f: f.stat().st_mtime_ns for f in before} == before
    assert (posed / "ablation.md").read_text() == page_before


def test_another_call_adds_to_the_same_tables(tmp_path: Path) -> None:
    run(tmp_path, only=("iterations",))
    assert tables(tmp_path)["pose"]["both"]["seeds"] == 1
    run(tmp_path, only=("pose",), seeds=(1,))
    found = tables(tmp_path)
    assert found["pose"]["both"]["seeds"] == 2
    assert not found["pose"]["both"]["claim"]
    assert found["pose"]["neither"]["seeds"] == 1
    assert found["pose"]["neither"]["against_reference"]["epe"]["count"] == 1, (
        "compared with the same seed of the reference alone"
    )
    assert found["iterations"]["T = 2"]["seeds"] == 1
    assert found["fusion"]["gated"]["seeds"] == 0


def test_minutes_end_it_in_order_and_it_goes_on_to_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as m:
        m.setenv("POSEGAUSSIAN_FAKE", '{"step_s": 1.0}')
        said = run(tmp_path / "a", only=("heads",), minutes=0.035)
    assert any("the minutes are over, 3 cells of 3 are left" in line for line in said)
    kept = steps_kept(tmp_path / "a" / "cells" / PLAIN / "seed-0" / "checkpoints")[0]
    assert 0 < kept < CONFIG.steps
    assert tables(tmp_path / "a")["heads"]["rotation 3, opacity 2"]["cells"][0]["state"] == f"step {kept} of 6"
    assert f"0 (step {kept} of 6)" in (tmp_path / "a" / "ablation.md").read_text()
    run(tmp_path / "a", only=("heads",))
    run(tmp_path / "b", only=("heads",))
    assert _timeless(tables(tmp_path / "a")) == _timeless(tables(tmp_path / "b"))


def _timeless(found: dict[str, dict[str, Any]]) -> str:
    for group in found.values():
        for row in group.values():
            row["cells"] = [{k: v for k, v in c.items() if k not in ("minutes", "machine")} for c in row["cells"]]
    return json.dumps(found)


def test_iterations_are_measured_on_one_training_which_they_leave_alone(tmp_path: Path) -> None:
    run(tmp_path, only=("iterations",))
    assert cells(tmp_path) == [f"{PLAIN}/seed-0"]
    trained = tmp_path / "cells" / PLAIN / "seed-0"
    checkpoint = read_latest(trained / "checkpoints")[0]
    assert checkpoint is not None
    assert packed(unpacked(checkpoint.data)) == checkpoint.data
    found = json.loads((trained / "iterations.json").read_text())
    assert list(found) == ["1", "2", "3"]
    assert found["3"] == json.loads((trained / "result.json").read_text())["numbers"], (
        "the trained T says what the training's validation said"
    )


def test_a_cell_that_fails_is_said_and_the_others_go_on(tmp_path: Path) -> None:
    blocked = tmp_path / "cells" / PLAIN / "seed-0"
    (blocked / "checkpoints" / "00000003").mkdir(parents=True)  # of another training: nothing in it can be read
    said: list[str] = []
    order = AblationOrder(CONFIG, tmp_path, (0,), ("heads",), workers=0, device="cpu", pictures=False)
    assert ablate(order, said.append, PARTS) is False
    assert any(line.startswith(f"{PLAIN}, seed 0: ") for line in said)
    assert len(cells(tmp_path)) == 2
    row = tables(tmp_path)["heads"]["rotation 3, opacity 2"]
    assert row["seeds"] == 0
    assert row["cells"][0]["failure"] in (tmp_path / "ablation.md").read_text()


def test_a_frame_that_cannot_be_made_ends_all_and_the_tables_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSEGAUSSIAN_FAKE", '{"raises": 1}')
    with pytest.raises(FrameError):
        run(tmp_path, only=("heads",))
    assert NOT_RUN in (tmp_path / "ablation.md").read_text()


def test_a_folder_of_another_configuration_is_refused_by_name(posed: Path) -> None:
    with pytest.raises(ConfigError, match=r"another configuration \(batch: 8 -> 3\)"):
        run(posed, config=CONFIG.model_copy(update={"batch": 3}), only=("pose",))
    with pytest.raises(ConfigError, match=r"depth_steps: 4 -> 8"):
        run(posed, config=with_steps(CONFIG, 12), only=("pose",))


def test_steps_keep_the_share_of_the_phases() -> None:
    assert [(c.depth_steps, c.joint_steps) for c in (with_steps(CONFIG, n) for n in (None, 3, 600))] == [
        (4, 2),
        (2, 1),
        (400, 200),
    ]
    with pytest.raises(ConfigError, match="begin with random weights"):
        with_steps(CONFIG.model_copy(update={"start": "x.safetensors"}), 3)


def test_a_page_without_any_training_says_not_run_everywhere_and_what_is_comparable(tmp_path: Path) -> None:
    found = report(CONFIG, tmp_path, [0, 1, 2], {})
    lines = page(found)
    for group in found["groups"]:
        at = lines.index(f"## {group['title']}")
        body = lines[at + 4 : at + 4 + len(group["rows"])]
        assert all(line.startswith("| ") and NOT_RUN in line for line in body), group["name"]
        assert group["notes"][0] in lines[at + 5 + len(body)]
    assert not list(tmp_path.iterdir())
    text = "\n".join(lines)
    assert "0.80" in text
    assert "tab:ablation_loss" in text


def test_the_page_marks_what_is_no_claim(posed: Path) -> None:
    found = report(CONFIG, posed, [0, 1], {})
    assert sum("2, no claim" in line for line in page(found)) == len(EVERY["pose"].rows) + 4, (
        "the default stands in four tables more"
    )


def test_a_spread_of_one_value_has_no_error_and_of_equal_ones_none_at_all() -> None:
    assert spread([2.0]) == {"mean": 2.0, "error": None, "count": 1}
    assert spread([2.0, 2.0]) == {"mean": 2.0, "error": 0.0, "count": 2}
    assert spread([1.0, 3.0])["error"] == pytest.approx(1.0)


def test_unknown_groups_and_seeds_are_refused_and_a_plan_loads_no_torch(tmp_path: Path) -> None:
    order = AblationOrder(CONFIG, tmp_path / "none", (0,), ("fusion", "colour"))
    with pytest.raises(ConfigError, match="--only colour: no such group; these are fusion, pose"):
        plan_lines(order)
    code = (
        "import sys; from typer.testing import CliRunner; from posegaussian.dags.cli.app import app; "
        "out = CliRunner().invoke(app, ['ablate', '--plan', '--only', 'fusion,tps', '--seeds', '4', '--steps', '60']); "
        "CliRunner().invoke(app, ['ablate', '--help']); "
        "print(out.output); assert out.exit_code == 0, out; assert 'torch' not in sys.modules"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3])},
    )
    assert done.returncode == 0, done.stderr
    assert "fusion=outer, seed 4: not run" in done.stdout
    assert "tps=adaptive, seed 4: not run, with weights fast" in done.stdout
    assert "pictures=fusion=outer, seed 4: not run, after its training" in done.stdout
    assert "7 trainings of 60 steps and 11 runs to do, 0 done" in done.stdout
    assert not list(tmp_path.iterdir())
