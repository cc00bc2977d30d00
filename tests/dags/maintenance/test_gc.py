"""What gc offers, what it deletes, and what it never touches."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from posegaussian.dags.maintenance import garbage_collection
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.planning.variants import variant
from posegaussian.dags.runtime import run_registry
from posegaussian.dags.runtime.entering import enter
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive import set_aside
from posegaussian.storage.archive.deletion import SETTLED_SECONDS, folder_bytes
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.model.errors import ArchiveError, LeaseHeld
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    """A copy of the finished archive that may be changed."""
    return finished.copy(tmp_path / "archive")


def found(plan: Plan) -> list[garbage_collection.Deletable]:
    return garbage_collection.items([plan], Archive(plan.context.sequence.root.parent))


def of(items: Iterable[garbage_collection.Deletable], *kinds: str) -> list[garbage_collection.Deletable]:
    return [i for i in items if i.kind in kinds]


def age(path: Path) -> None:
    then = time.time() - 2 * SETTLED_SECONDS
    os.utime(path, (then, then))


def test_nothing_is_touched_without_apply(archive: Pipeline) -> None:
    before = content(archive)
    items = found(archive.plan())
    assert {i.what.partition(",")[0] for i in of(items, "arrays")} >= {
        "frames/color",
        "gaussians/scale",
        "gaussians/rotation",
        "gaussians/opacity",
    }
    assert all(i.bytes > 0 and "when something reads it again" in i.again for i in of(items, "arrays"))
    assert_same_content(content(archive), before)
    assert archive.plan().all_fresh


def test_arrays_go_and_come_back_where_they_are_needed(archive: Pipeline, finished: Pipeline) -> None:
    plan = archive.plan()
    items = of(found(plan), "arrays")
    before = folder_bytes(archive.root / NAME)
    freed = garbage_collection.apply(items, [plan])
    # Receipts grow by a word for each output that is marked as dropped.
    assert freed == sum(i.bytes for i in items)
    assert before - folder_bytes(archive.root / NAME) > 0.95 * freed
    assert archive.plan().all_fresh, "dropped is fresh"
    assert of(found(archive.plan()), "arrays") == []
    assert set(archive.ran("orbit")) == {"frames", "gaussians", "rendering"}
    # Explicitly kept arrays are not offered.
    other = finished.with_settings("keep.frames/color=always").plan()
    assert not [i for i in of(found(other), "arrays") if i.what.startswith("frames/color")]


def test_paths_that_are_not_asked_for(archive: Pipeline) -> None:
    archive.run("orbit")
    plan = archive.plan()
    (item,) = of(found(plan), "paths")
    assert "camera path orbit-" in item.what
    assert item.again.startswith("rendering")
    garbage_collection.apply([item], [plan])
    assert not list((archive.root / NAME / "rendering").glob("orbit-*"))
    assert list((archive.root / NAME / "rendering").glob("held_out-*"))
    assert archive.plan().all_fresh
    assert archive.ran("orbit") == {"rendering": 3}


def test_partitions_beyond_the_range_and_stages_that_are_not_needed(archive: Pipeline) -> None:
    shorter = archive.with_settings("frames.range=0:4")
    shorter.run()
    plan = shorter.plan()
    ranged = of(found(plan), "range")
    assert {i.what for i in ranged} >= {
        "frames beyond the range",
        "depth beyond the range",
        "gaussians beyond the range",
    }
    garbage_collection.apply(ranged, [plan])
    assert of(found(shorter.plan()), "range") == []
    assert shorter.plan().all_fresh
    without = Pipeline(archive.root, archive.folder, ["frames.range=0:4"], held_out="[]").plan()
    assert {i.what for i in of(found(without), "stages", "paths")} >= {"metrics, not needed"} or of(
        found(without), "paths"
    )


def test_strays_are_found_once_they_are_old_enough_to_be_nobodys(archive: Pipeline) -> None:
    root = archive.root / NAME
    shard = next(p for p in (root / "depth/depth").glob("c.*"))
    partial = shard.with_name(f"{shard.name}.0123.partial")
    partial.write_bytes(b"x" * 1000)
    receipt = root / "_receipts/depth/p000001.json"
    receipt.unlink()
    assert of(found(archive.plan()), "strays") == [], "they may belong to a task that is at work"
    age(partial)
    for file in (root / "depth").rglob("*"):
        age(file)
    plan = archive.plan()
    (item,) = of(found(plan), "strays")
    assert item.what == "1 half written files, 14 shards without a receipt"  # depth and confidence of seven views
    garbage_collection.apply([item], [plan])
    assert not partial.exists()
    assert archive.ran() == {"depth": 1}, "what has a receipt was not touched"


def test_shards_of_a_drop_that_was_killed_midway_are_strays(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    """The receipt says dropped before the first file goes: a death in between leaves files, not a false promise."""

    class Death(BaseException):
        pass

    def die(self: Path, missing_ok: bool = False) -> None:
        if "gaussians" in str(self) and ".lease" not in self.name:
            raise Death
        real(self, missing_ok=missing_ok)

    real = Path.unlink
    plan = archive.plan()
    monkeypatch.setattr(Path, "unlink", die)
    with pytest.raises(Death):
        garbage_collection.apply([i for i in of(found(plan), "arrays") if "gaussians/scale" in i.what], [plan])
    monkeypatch.undo()
    for file in (archive.root / NAME / "gaussians").rglob("*"):
        age(file)
    plan = archive.plan()
    assert plan.all_fresh
    (item,) = of(found(plan), "strays")
    garbage_collection.apply([item], [plan])
    assert of(found(archive.plan()), "strays") == []
    assert archive.plan().all_fresh


def test_the_newest_runs_and_everything_of_unknown_origin_stay(archive: Pipeline) -> None:
    for n in range(garbage_collection.KEPT_RUNS + 3):
        folder = archive.root / "_runs" / f"20260101T0000{n:02d}"
        folder.mkdir(parents=True)
        (folder / "pipeline.yaml").write_text("{}")
    mine = archive.root / NAME / "my_notes"
    mine.mkdir()
    (mine / "c").mkdir()
    (mine / "c" / "0").write_text("not made by any stage")
    age(mine / "c" / "0")
    newer = archive.root / NAME / "_receipts/future/p000000.json"
    newer.parent.mkdir()
    data = json.loads((archive.root / NAME / "_receipts/depth/p000000.json").read_bytes())
    del data["checksum"]
    newer.write_text(json.dumps({**data, "stage": "future"}))
    plan = archive.plan()
    items = found(plan)
    (runs,) = of(items, "runs")
    assert "3 oldest runs" in runs.what
    sources = {p: p.read_bytes() for p in (archive.root / NAME / "source").rglob("*") if p.is_file()}
    garbage_collection.apply(items, [plan])
    assert len(list((archive.root / "_runs").iterdir())) == garbage_collection.KEPT_RUNS
    assert (mine / "c" / "0").exists()
    assert newer.exists()
    assert {p: p.read_bytes() for p in sources} == sources


@pytest.mark.parametrize(
    ("task", "kind"),
    [
        (Task(NAME, "survey", None, 99), None),
        (Task(NAME, "depth", 99), "range"),
        (Task(NAME, "frames", 0, 99), "stages"),
        (Task(NAME, "rendering", 0, None, "arc-0"), "paths"),
        (Task(NAME, "future", 0), None),
    ],
)
def test_constants_of_the_sequence_and_unknown_stages_are_never_offered(
    task: Task, kind: str | None, finished: Pipeline
) -> None:
    assert garbage_collection._kind(finished.plan(), task) == kind


def test_nothing_computed_is_offered_while_a_source_is_missing(
    archive: Pipeline, tmp_path: Path, person_folder: Path
) -> None:
    import shutil

    folder = tmp_path / "capture"
    shutil.copytree(person_folder, folder)
    moved = Pipeline(tmp_path / "moved", folder, ["frames.range=0:2"])
    moved.register()
    moved.run()
    next((folder / "images").rglob("*.png")).unlink()
    plan = moved.plan()
    assert of(found(plan), "arrays", "paths", "range", "stages") == []
    assert "nothing could be made again" in garbage_collection.notes([plan])[0]


def test_the_command_shows_and_deletes_only_what_it_is_told_to(archive: Pipeline) -> None:
    from typer.testing import CliRunner

    from posegaussian.dags.cli.app import app

    given = ["--archive", str(archive.root), *(part for s in archive.assignments for part in ("--set", s))]
    shown = CliRunner().invoke(app, ["gc", *given])
    assert shown.exit_code == 0, shown.output
    assert "nothing was deleted: add --apply" in shown.output
    assert of(found(archive.plan()), "arrays")
    done = CliRunner().invoke(app, ["gc", *given, "--kind", "arrays", "--apply"])
    assert "deleted:" in done.output
    assert "nothing could go" in CliRunner().invoke(app, ["gc", *given, "--kind", "arrays"]).output
    wrong = CliRunner().invoke(app, ["gc", *given, "--kind", "array"])
    assert "no kind 'array'; the kinds are arrays, paths" in str(wrong.exception)


def test_not_while_a_run_is_at_work(archive: Pipeline) -> None:
    plan = archive.plan()
    with enter(plan, RunTerms("someone")), pytest.raises(ArchiveError, match="is worked on by run someone"):
        garbage_collection.apply(found(plan), [plan])
    assert archive.plan().all_fresh


@pytest.fixture
def neighbours(archive: Pipeline) -> Pipeline:
    """The sequence and another one, each with a variant in one folder, and with a result that lies aside; old runs."""
    shutil.copytree(archive.root / NAME, archive.root / "other")
    settings = archive.context().settings
    for sequence in (SequenceGroup(archive.root / name) for name in (NAME, "other")):
        variant(sequence, settings, {"of": "both"}, ())
        assert set_aside.put(sequence, list(scan_receipts(sequence))[:1])
    for n in range(garbage_collection.KEPT_RUNS + 3):
        (archive.root / "_runs" / f"20260101T0000{n:02d}").mkdir(parents=True)
    return archive


def beside(pipeline: Pipeline) -> list[str]:
    """Names of sequences that have variants, and of those that have results aside."""
    return [p.name for top in ("_variants/*", "_kept") for p in sorted(pipeline.root.glob(f"{top}/*"))]


def run_gc(pipeline: Pipeline, *words: str) -> None:
    from typer.testing import CliRunner

    from posegaussian.dags.cli.app import app

    done = CliRunner().invoke(app, ["gc", *pipeline.options, "--kind", "variants", "--kind", "runs", "--apply", *words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception


def test_of_named_sequences_nothing_of_the_others_goes(neighbours: Pipeline) -> None:
    inside = SequenceGroup(next(neighbours.root.glob(f"_variants/*/{NAME}")))
    before = content(neighbours)
    with Lease.take(run_registry.folder(inside) / "someone.lease", "someone"):
        run_gc(neighbours, "--sequence", "other")
    assert beside(neighbours) == [NAME, NAME]
    assert len(list((neighbours.root / "_runs").iterdir())) == garbage_collection.KEPT_RUNS + 3, "of whom, is not said"
    run_gc(neighbours)
    assert beside(neighbours) == []
    assert len(list((neighbours.root / "_runs").iterdir())) == garbage_collection.KEPT_RUNS
    assert_same_content(content(neighbours), before)


def test_not_while_a_run_is_at_work_on_a_variant(neighbours: Pipeline) -> None:
    inside = SequenceGroup(next(neighbours.root.glob("_variants/*/other")))
    with Lease.take(run_registry.folder(inside) / "someone.lease", "someone"):
        for words in ((), ("--sequence", "other")):
            with pytest.raises(LeaseHeld, match="sequence other is worked on by run someone"):
                run_gc(neighbours, *words)
    assert beside(neighbours) == ["other", NAME, "other", NAME]


def test_of_two_at_once_the_second_waits_for_the_first(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(garbage_collection, "PATIENCE", 0.0)
    plan = archive.plan()

    def second() -> None:
        with pytest.raises(LeaseHeld, match="is held by run gc-"):
            garbage_collection.apply([replace(item, delete=lambda: pytest.fail("both at once"))], [plan])

    item = replace(of(found(plan), "arrays")[0], delete=second)
    garbage_collection.apply([item], [plan])
