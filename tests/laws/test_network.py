"""The laws of a stage that its weights make: without any it is as good as absent, with them Gaussians follow it, and
other weights make it stale."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from posegaussian.dags.config.settings import RunSettings
from posegaussian.dags.diagnostics.learned_share import sentences
from posegaussian.dags.diagnostics.profile import Spending
from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import Event, TaskDone, TaskFailed, TaskStarted, record
from posegaussian.dags.runtime.executors.dask import DaskBackend
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.training.weights import save_weights
from posegaussian.stages.network.card import Card
from posegaussian.stages.network.model.network import PoseGaussianNetwork
from posegaussian.stages.network.model.presets import PRESETS, Preset
from posegaussian.stages.network.params import QUATERNIONS, SINGLE_OPACITY, TURNED, TWISTED
from posegaussian.stages.rendering.sources import COUNTS, map_arrays, unrefined_arrays
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.receipts import scan_receipts, write_receipt
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, receipts

FRAMES = "frames.range=0:2"


def weights(file: Path, seed: int = 0, confidence: float | None = None, preset: Preset = PRESETS["fast"]) -> Path:
    """Random weights that do say something; with `confidence`, its number everywhere."""
    torch.manual_seed(seed)
    network = PoseGaussianNetwork(preset)
    with torch.no_grad():
        for p in network.last_layers():
            p.add_(0.05 * torch.randn_like(p))
        if confidence is not None:
            weight, bias = list(network.heads.last["confidence"].parameters())
            weight.zero_()
            bias.fill_(confidence)
    save_weights(
        file,
        network.state_dict(),
        Card("random", "fast", preset.as_json(), 3, "none", "none", 0.0, "none", (("a",),)),
    )
    return file


def run(folder: Path, root: Path, *settings: str, partition: int = 2) -> Pipeline:
    p = Pipeline(root, folder, [FRAMES, *settings], partition)
    p.register()
    p.run()
    return p


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return weights(tmp_path_factory.mktemp("weights") / "random.safetensors")


@pytest.fixture(scope="module")
def plain(person_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    return run(person_folder, tmp_path_factory.mktemp("plain") / "archive")


@pytest.fixture(scope="module")
def learned(person_folder: Path, file: Path, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    return run(
        person_folder, tmp_path_factory.mktemp("learned") / "archive", f"network.weights={file}", "network.iterations=2"
    )


def test_without_weights_nothing_of_it_is_planned_read_or_written(plain: Pipeline) -> None:
    plan = plain.plan()
    assert "network.weights is none" in plan.unneeded["network"]
    assert "network" not in plan.context.facts
    assert not (plain.root / NAME / "network").exists()
    assert not any(key[0] == "network" for key in receipts(plain))
    assert sentences([plan]) == []


def test_with_weights_only_what_follows_is_another_and_nothing_is_lost(plain: Pipeline, learned: Pipeline) -> None:
    after = ("network", "gaussians", "rendering", "metrics")
    assert_same_content(content(plain, but=after), content(learned, but=after))
    results = Results(learned.context())
    for view in learned.context().views.sources:
        floor, depth, share = (
            results.read(n, range(2), view) for n in ("depth/depth", "network/depth", "network/share")
        )
        assert np.array_equal(floor > 0, depth > 0), "where there was a surface there is one"
        assert (depth[floor > 0] != floor[floor > 0]).any()
        confidence = results.read("network/confidence", range(2), view).astype(np.float64)
        # float16 confidences of a mean that is float32
        np.testing.assert_allclose(
            share[:, 0],
            [c[f > 0].mean() if (f > 0).any() else 0 for c, f in zip(confidence, floor, strict=True)],
            atol=1e-3,
        )
        said = results.read("network/blend", range(2), view)
        assert np.array_equal(
            results.read("gaussians/confidence", range(2), view)[:, 0],
            np.where(results.read("gaussians/opacity", range(2), view)[:, 0] > 0, said, 0),
        )
    (said,) = sentences([learned.plan()])
    assert "holds its depth for better than the analytic floor's at" in said


MODULES = {
    "loading",
    "reading",
    "rectification",
    "evidence",
    "image encoder",
    "fusion",
    "refinement",
    "pose encoder",
    "depth encoder",
    "decoder",
    "heads",
    "silhouettes",
    "pulling back",
}


def rows(pipeline: Pipeline) -> list[dict]:
    """The ledger's rows of the network."""
    ledger.rebuild(pipeline.session.archive)
    return [r for r in ledger.read(pipeline.session.archive) if r["stage"] == "network"]


@pytest.mark.parametrize("back_end", ["serial", "dask"])
def test_the_ledger_says_what_the_modules_took_and_no_result_knows_it(
    learned: Pipeline, tmp_path: Path, back_end: str
) -> None:
    copy = learned.copy(tmp_path / "copy")
    backend = DaskBackend(RunSettings(workers=1)) if back_end == "dask" else SerialBackend()
    events = copy.run(selection=Selection(force=frozenset({"network"})), backend=backend)
    (done,) = [e for e in events if isinstance(e, TaskDone) and e.task.stage == "network"]
    (row,) = rows(copy)
    assert row["modules"] == done.receipt.facts["modules"] == record(done)["modules"]
    assert set(row["modules"]) == MODULES
    assert all(seconds > 0 for seconds in row["modules"].values())
    assert sum(row["modules"].values()) <= row["seconds"]
    (said,) = Spending.of(copy.session.archive, [NAME]).sentences()
    assert said.startswith("network took ")
    assert "in 1 task: " in said
    assert Spending.of(copy.session.archive, ["another"]).sentences() == []
    assert receipts(copy) == receipts(learned), "equal fingerprints and contents"
    assert_same_content(content(copy), content(learned))
    assert [r["modules"] for r in ledger.read(copy.session.archive) if r["stage"] == "depth"] == [None]


def test_an_archive_of_before_modules_were_measured_stays_fresh_and_open(learned: Pipeline, tmp_path: Path) -> None:
    copy = learned.copy(tmp_path / "copy")
    sequence = copy.session.archive.sequence(NAME)
    for r in list(scan_receipts(sequence)):
        write_receipt(sequence, replace(r, facts={k: v for k, v in r.facts.items() if k != "modules"}))
    assert copy.plan().all_fresh
    assert [r["modules"] for r in rows(copy)] == [None]
    assert Spending.of(copy.session.archive, [NAME]).sentences() == []


def test_how_a_sequence_is_cut_changes_no_byte(
    learned: Pipeline, person_folder: Path, file: Path, tmp_path: Path
) -> None:
    other = run(person_folder, tmp_path / "archive", f"network.weights={file}", "network.iterations=2", partition=1)
    assert_same_content(content(other), content(learned))


def test_turning_it_on_and_off_again_reruns_nothing_before_it(
    plain: Pipeline, learned: Pipeline, file: Path, tmp_path: Path
) -> None:
    copy = plain.copy(tmp_path / "copy")
    on = copy.with_settings(f"network.weights={file}", "network.iterations=2")
    assert set(on.ran()) == {"network", "gaussians", "rendering", "metrics"}
    assert_same_content(content(on), content(learned))
    assert set(copy.ran()) == {"gaussians", "rendering", "metrics"}
    assert_same_content(content(copy, but=("network",)), content(plain))


def test_other_weights_in_the_same_file_make_it_stale(learned: Pipeline, tmp_path: Path) -> None:
    copy = learned.copy(tmp_path / "copy")
    own = weights(tmp_path / "own.safetensors")
    named = Pipeline(copy.root, copy.folder, [FRAMES, f"network.weights={own}", "network.iterations=2"])
    named.run()
    assert named.plan().all_fresh
    weights(own, seed=1)
    assert named.plan().counts("network")[State.STALE]


def test_weights_that_are_exchanged_between_order_and_work_compute_nothing(learned: Pipeline, tmp_path: Path) -> None:
    copy = learned.copy(tmp_path / "copy")
    own = weights(tmp_path / "own.safetensors")
    named = Pipeline(copy.root, copy.folder, [FRAMES, f"network.weights={own}", "network.iterations=2"])
    selection = Selection(only=frozenset({"network"}))
    events: list[Event] = []

    def tell(event: Event) -> None:
        events.append(event)
        if isinstance(event, TaskStarted):
            weights(own, seed=1)

    Run([named.plan(selection=selection)], selection, SerialBackend(), [tell]).go()
    (failed,) = [e for e in events if isinstance(e, TaskFailed)]
    assert failed.kind == "other code"
    assert "has other models or weights than this run was planned with" in failed.error


def test_a_confidence_near_zero_leaves_the_floor(plain: Pipeline, tmp_path: Path) -> None:
    """The confidence head's number is bounded: at -60000 a share of 0.0025 is left, and the view is reported."""
    file = weights(tmp_path / "unsure.safetensors", confidence=-6e4)
    copy = plain.copy(tmp_path / "copy").with_settings(f"network.weights={file}", "network.iterations=1")
    warned = [w for e in copy.run() if hasattr(e, "receipt") for w in e.receipt.warnings if e.task.stage == "network"]
    assert any("mean confidence" in w for w in warned)
    results = Results(copy.context())
    view = copy.context().views.sources[0]
    floor, depth = (results.read(n, range(2), view) for n in ("depth/depth", "network/depth"))
    inside = floor > 0
    # inverse depth changes by at most a quarter, of which 0.0025 counts
    assert np.abs(1 / depth[inside] - 1 / floor[inside]).max() <= 0.0026 * 0.5 / floor[inside].min()


def test_more_iterations_than_were_trained_are_told_and_missing_weights_refused(plain: Pipeline, file: Path) -> None:
    more = plain.with_settings(f"network.weights={file}", "network.iterations=4")
    assert any("was trained with 1 to 3" in n for n in more.plan().notes)
    with pytest.raises(ConfigError, match=r"nowhere\.safetensors.*neither weights that ship"):
        plain.with_settings("network.weights=nowhere.safetensors").plan()


def test_weights_of_quaternions_and_a_single_opacity_run_and_their_twist_is_kept(
    person_folder: Path, tmp_path: Path
) -> None:
    """To the pictures and through refinement; weights of normals leave no trace of it."""
    preset = replace(PRESETS["fast"], rotation_head="quaternion", opacity_head="single", normalisation="batch")
    own = weights(tmp_path / "quaternions.safetensors", preset=preset)
    settings = (f"network.weights={own}", "frames.range=0:1", "refinement.steps=2", "keep={gaussians/twist: always}")
    p = run(person_folder, tmp_path / "archive", *settings)
    results = Results(p.context())
    view = results.context.views.sources[0]
    twist = results.read("gaussians/twist", range(1), view)[0].astype(np.float32)
    np.testing.assert_allclose((twist**2).sum(axis=0), 1, atol=3e-3)  # of two float16
    surface = results.read("network/depth", range(1), view)[0] > 0
    assert (np.abs(twist[1][surface]) > 0.01).mean() > 0.5
    assert unrefined_arrays(results.context.facts)[-1] == "gaussians/twist"
    assert "refinement/twist" in map_arrays(results.context.facts)
    count = int(results.read(COUNTS, range(1), view)[0])
    pixel, refined = (results.read(f"refinement/{n}", range(1), view, count)[0] for n in ("pixel", "twist"))
    before, after = twist.reshape(2, -1)[:, pixel], refined.T.astype(np.float32)
    # Refinement starts from the network's turn: two steps of two pictures move its tangent by about 0.1 a picture.
    assert surface.reshape(-1)[pixel].all()
    assert np.abs(before[0] * after[1] - before[1] * after[0]).max() < 0.5


def test_weights_of_normals_leave_no_trace_of_a_twist(learned: Pipeline) -> None:
    assert not learned.context().facts & {QUATERNIONS, SINGLE_OPACITY, TURNED, TWISTED}
    assert not any(Results(learned.context()).has(a) for a in ("gaussians/twist", "network/turn"))
