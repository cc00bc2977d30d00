"""Few files and folders a task; and archives of earlier versions, with a folder for every number of a shard, go on
as they are."""

from __future__ import annotations

import os
from pathlib import Path
from uuid import uuid4

import pytest

from posegaussian.dags.maintenance import reshard
from posegaussian.dags.planning.plan import make_plan
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.planning.variants import others, share, variant
from posegaussian.dags.runtime.events import RunEnded, TaskDone
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.in_flight import Rules
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive.integrity import Count, faults
from posegaussian.storage.archive.receipts import (
    ReceiptKey,
    damaged_files,
    missing_files,
    remove_receipt,
    scan_receipts,
)
from posegaussian.storage.archive.store import Archive, SequenceGroup
from tests.support.nested_archive import nest, shards
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, film, receipts

SETTINGS = [
    "depth.method=hull",
    *(f"effects.{e}=off" for e in ("silhouette_clipping", "hole_filling", "outline_evening")),
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """Four frames of two source cameras and a held-out one, run whole. Read it, do not change it."""
    folder = tmp_path_factory.mktemp("narrow")
    film(folder / "person", views=3, frames=4)
    p = Pipeline(folder / "archive", folder / "person", SETTINGS)
    p.register()
    p.run()
    return p


@pytest.fixture
def old(made: Pipeline, tmp_path: Path) -> Pipeline:
    """The same as an earlier version made it."""
    p = made.copy(tmp_path / "old")
    nest(sequence(p))
    assert lying(p) == {"nested"}
    return p


def sequence(p: Pipeline) -> SequenceGroup:
    return Archive.open(str(p.root)).sequence(NAME)


def lying(p: Pipeline) -> set[str]:
    return {how for how, keys in shards(p.root / NAME).items() if keys}


def assert_sound(p: Pipeline, like: Pipeline) -> None:
    plan = p.plan()
    assert plan.all_fresh, [v.reasons for v in plan.verdicts.values() if v.reasons]
    assert list(faults(sequence(p), Count())) == []
    assert receipts(p) == receipts(like)
    assert_same_content(content(p), content(like))


def test_a_finished_task_takes_few_files_and_folders(finished: Pipeline) -> None:
    """Of 39 tasks, arrays' folders and descriptions included;
    24 frames (156 tasks) take 8.5 a task, of which 6.8 are shards."""
    walked = list(os.walk(finished.root))
    tasks = len(receipts(finished))
    assert sum(len(folders) + len(files) for _, folders, files in walked) / tasks <= 11
    for folder in sequence(finished).walk_arrays():
        assert not any(p.is_dir() for p in folder.iterdir()), f"{folder} has folders in it"


def test_an_archive_of_an_earlier_version_is_whole_and_made_anew_where_it_lies(old: Pipeline, made: Pipeline) -> None:
    assert_sound(old, made)
    assert old.ran() == {}
    old.run(selection=Selection(force=frozenset({"depth", "survey", "rendering"})))
    assert lying(old) == {"nested"}
    assert_sound(old, made)


def test_more_frames_go_on_in_folders(made: Pipeline, tmp_path: Path) -> None:
    p = Pipeline(tmp_path / "archive", made.folder, SETTINGS)
    p.register()
    p.with_settings("frames.range=0:2").run()
    nest(sequence(p))
    p.run()
    assert_same_content(content(p, ("rendering", "metrics")), content(made, ("rendering", "metrics")))
    assert p.plan().all_fresh
    assert list(faults(sequence(p), Count())) == []
    assert any(k.startswith("depth/depth/c/1/") for k in shards(p.root / NAME)["nested"])
    assert not any(k.startswith("depth/") for k in shards(p.root / NAME)["flat"])


def test_resharding_names_all_shards_anew(old: Pipeline, made: Pipeline) -> None:
    reshard.reshard(old.plan(), 4)
    assert lying(old) == {"flat"}
    assert old.plan().all_fresh
    assert list(faults(sequence(old), Count())) == []
    assert_same_content(content(old), content(made))


@pytest.mark.parametrize("there", ["nothing", "flat"])
def test_a_variant_takes_over_what_lies_in_folders(there: str, old: Pipeline, made: Pipeline) -> None:
    """Where the variant has arrays of its own, under the names they have:
    none of its shards is lost or read as zeros."""
    mine = old.context().sequence
    context = variant(mine, old.context().settings, {"nothing": "differs"}, ("held_out",))
    beside = context.sequence
    share(context, [sequence(made)] if there == "flat" else others(mine))
    for r in list(scan_receipts(beside)):
        if there == "flat" and (r.stage == "depth" or r.partition is None):
            remove_receipt(beside, *ReceiptKey(r.stage, r.partition, r.view, r.path))
    share(context, others(mine))
    assert make_plan(context).all_fresh
    assert all(missing_files(beside, r) == [] for r in scan_receipts(beside))
    assert list(faults(beside, Count())) == []
    own = shards(beside.root)
    assert own["flat" if there == "nothing" else "nested"] == []
    taken, known = content(Pipeline(beside.root.parent, old.folder)), content(made)
    assert {
        o.array for r in scan_receipts(beside) for o in r.outputs if o.array.partition("/")[0] != "metrics"
    } <= taken.keys()
    assert_same_content(taken, {k: v for k, v in known.items() if k in taken})


def test_going_back_to_a_setting_takes_over_what_lay_in_folders(old: Pipeline, made: Pipeline) -> None:
    def run(p: Pipeline) -> tuple[int, int]:
        events: list = []
        Run(
            [p.plan()], Selection(), SerialBackend(), [events.append], rules=Rules(RunTerms(uuid4().hex, kept=10**9))
        ).go()
        return sum(isinstance(e, TaskDone) for e in events), next(e for e in events if isinstance(e, RunEnded)).taken

    run(old.with_settings("frames.size=32"))
    computed, taken = run(old)
    assert computed == 0
    assert taken > 0
    known = content(made)
    assert_same_content({k: v for k, v in content(old).items() if k in known}, known)
    assert old.plan().all_fresh
    assert list(faults(sequence(old), Count())) == []
    assert "flat" in lying(old), "arrays of another size were replaced"


def test_resharding_links_what_is_not_partitioned_under_the_names_of_the_new_arrays(
    old: Pipeline, made: Pipeline, tmp_path: Path
) -> None:
    """Any task's result stands for one of the survey here: it is linked as it is."""
    receipt = next(r for r in scan_receipts(sequence(old)) if r.stage == "depth")
    new = made.copy(tmp_path / "new")
    into = sequence(new)
    for o in receipt.outputs:
        for shard in into.place(o.array).glob("c.*"):
            shard.unlink()
    linked = reshard._linked(Results(old.context()), new.context(), Task(NAME, "survey", None, 0), receipt, {})
    assert linked.contents == receipt.contents
    assert damaged_files(into, linked) == []
    assert {f.key for o in linked.outputs for f in o.files} == {
        k for k in shards(into.root)["flat"] if k.startswith("depth/")
    }
