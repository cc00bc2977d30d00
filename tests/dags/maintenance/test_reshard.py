"""Another partition length without computing: everything stays fresh, contents are equal, a death leaves old or new."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from posegaussian.dags.maintenance import reshard
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.runtime.entering import enter
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.ledger import row
from posegaussian.storage.archive.receipts import scan_receipts, write_receipt
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ArchiveError, LeaseHeld, LeaseLost
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, film, receipts


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """Six frames of three source cameras and a held-out one, run whole.
    Fewer shards than the shared fixture: each is synced."""
    folder = tmp_path_factory.mktemp("narrow")
    film(folder / "capture", views=3, size=48, frames=6, held_out=1)
    pipeline = Pipeline(folder / "archive", folder / "capture")
    pipeline.register()
    pipeline.run()
    return pipeline


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    """A copy of the finished archive (six frames, partitions of two) that may be changed."""
    return finished.copy(tmp_path / "archive")


def cut(pipeline: Pipeline, frames: int, *paths: str, give_up: bool = False) -> list[str]:
    return reshard.reshard(pipeline.plan(*paths), frames, give_up)


def length(pipeline: Pipeline) -> int:
    return Archive.open(str(pipeline.root)).sequence(NAME).partition_frames


@pytest.mark.parametrize("frames", [1, 4])
def test_all_stays_fresh_with_equal_content(frames: int, archive: Pipeline, finished: Pipeline) -> None:
    said = cut(archive, frames)
    assert "nothing computed" in said[0]
    plan = archive.plan()
    assert plan.all_fresh, [v.reasons for v in plan.verdicts.values() if v.reasons]
    assert len(plan.context.grid.partitions) == -(-6 // frames)
    assert archive.ran() == {}
    assert_same_content(content(archive), content(finished))


def test_receipts_equal_those_of_a_run_with_that_length(archive: Pipeline, finished: Pipeline, tmp_path: Path) -> None:
    cut(archive, 4)
    other = Pipeline(tmp_path / "other", finished.folder, partition=4)
    other.register()
    other.run()
    assert receipts(archive) == receipts(other)


def test_there_and_back_is_the_identity(archive: Pipeline, finished: Pipeline) -> None:
    cut(archive, 4)
    cut(archive, 2)
    assert receipts(archive) == receipts(finished)
    seconds = [
        sum(row(NAME, r)["seconds"] for r in scan_receipts(Archive.open(str(p.root)).sequence(NAME)))
        for p in (archive, finished)
    ]
    assert seconds[0] == pytest.approx(seconds[1], abs=0.01), "history keeps its seconds, up to their rounding"


def test_seconds_of_modules_go_along(archive: Pipeline) -> None:
    sequence = Archive.open(str(archive.root)).sequence(NAME)
    for r in [r for r in scan_receipts(sequence) if r.stage == "depth"]:  # partitions of 2, 2 and 2 frames
        modules = {"sweep": 2.0, **({"hull": 1.0} if r.partition == 1 else {})}
        write_receipt(sequence, replace(r, facts={**r.facts, "modules": modules}))
    cut(archive, 3)
    found = {
        r.partition: r.facts["modules"]
        for r in scan_receipts(Archive.open(str(archive.root)).sequence(NAME))
        if r.stage == "depth"
    }
    assert found == {0: {"sweep": 3.0, "hull": 0.5}, 1: {"sweep": 3.0, "hull": 0.5}}


def test_a_change_after_it_reruns_what_depends(archive: Pipeline) -> None:
    cut(archive, 6)
    assert archive.with_settings("gaussians.footprint=0.6").ran() == {"gaussians": 1, "rendering": 1, "metrics": 1}


def test_the_length_it_has_is_nothing_to_do(archive: Pipeline) -> None:
    assert "already" in cut(archive, 2)[0]


def test_what_cannot_be_keyed_anew_is_refused_unless_given_up(archive: Pipeline) -> None:
    changed = archive.with_settings("gaussians.footprint=0.6")
    with pytest.raises(ArchiveError, match=r"gaussians, rendering, metrics are made but not fresh.*--give-up"):
        cut(changed, 6)
    assert length(archive) == 2
    said = cut(changed, 6, give_up=True)
    assert "given up" in said[1]
    assert changed.ran() == {"gaussians": 1, "rendering": 1, "metrics": 1}


def test_a_camera_path_that_is_not_asked_for_is_refused_unless_named(archive: Pipeline) -> None:
    archive.run("orbit")
    with pytest.raises(ArchiveError, match=r"camera paths orbit-.* are rendered but not asked for"):
        cut(archive, 6)
    cut(archive, 6, "held_out", "orbit")
    assert archive.plan("orbit").all_fresh


def test_dropped_bytes_are_refused_with_the_command_that_makes_them(archive: Pipeline) -> None:
    from posegaussian.dags.runtime.eviction import Keeper

    Keeper([archive.with_settings("run.keep=as_declared").plan()]).sweep()
    with pytest.raises(ArchiveError, match=r"frames/color.* was dropped.*--force frames.* --force gaussians"):
        cut(archive, 6)


def test_the_command_says_what_it_did(archive: Pipeline) -> None:
    from typer.testing import CliRunner

    from posegaussian.dags.cli.app import app

    given = ["--archive", str(archive.root), *(part for s in archive.assignments for part in ("--set", s))]
    done = CliRunner().invoke(app, ["reshard", NAME, "--frames", "3", *given])
    assert (done.exit_code, "partitions of 3 frames instead of 2" in done.output) == (0, True), done.output


class Death(BaseException):
    """Stands for a kill: nothing catches it."""


@pytest.mark.parametrize("at", ["a receipt", "first rename", "second rename", "clean-up"])
def test_a_death_leaves_old_or_new(
    at: str, archive: Pipeline, finished: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content(finished)

    def die(*args: object, **kwargs: object) -> None:
        raise Death

    if at == "a receipt":
        written = 0
        real = reshard.write_receipt

        def some(*args: object) -> None:
            nonlocal written
            written += 1
            if written > 10:
                raise Death
            real(*args)  # type: ignore[arg-type]

        monkeypatch.setattr(reshard, "write_receipt", some)
    elif at == "clean-up":
        real_rmtree, calls = reshard.shutil.rmtree, []
        monkeypatch.setattr(
            reshard.shutil, "rmtree", lambda p, **k: die() if not k and not calls.append(p) else real_rmtree(p, **k)
        )
    else:
        real_rename, allowed = os.rename, 0 if at == "first rename" else 1
        done: list[object] = []

        def rename(a: Path, b: Path) -> None:
            if "_reshard" in str(a) + str(b):
                if len(done) >= allowed:
                    raise Death
                done.append(a)
            real_rename(a, b)

        monkeypatch.setattr(reshard.os, "rename", rename)
    with pytest.raises(Death):
        cut(archive, 4)
    monkeypatch.undo()
    assert length(archive) == (2 if at in ("a receipt", "first rename") else 4)
    assert archive.plan().all_fresh
    assert_same_content(content(archive), before)
    cut(archive, 6)
    assert archive.plan().all_fresh
    assert not (archive.root / "_reshard" / "old" / NAME).exists()


def test_not_while_a_run_is_at_work_and_a_run_planned_before_is_told(archive: Pipeline) -> None:
    plan: Plan = archive.plan()
    with enter(plan, RunTerms("someone")), pytest.raises(ArchiveError, match="is worked on by run someone"):
        cut(archive, 6)
    cut(archive, 6)
    with pytest.raises(ArchiveError, match="was cut into partitions of 6 frames since this run was planned with 2"):
        enter(plan, RunTerms("someone"))


def test_of_two_at_once_the_second_is_refused_and_the_first_ends_well(
    archive: Pipeline, finished: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, other, real = archive.plan(), archive.plan(), reshard.write_receipt

    def meanwhile(*args: Any) -> None:
        with pytest.raises(LeaseHeld, match="is held by run reshard-"):
            reshard.reshard(other, 6)
        real(*args)

    monkeypatch.setattr(reshard, "write_receipt", meanwhile)
    reshard.reshard(plan, 4)
    monkeypatch.undo()
    assert length(archive) == 4
    assert archive.plan().all_fresh
    assert_same_content(content(archive), content(finished))


@pytest.mark.parametrize("after", ["write_receipt", "_build"])
def test_one_that_lost_its_lease_replaces_nothing(
    after: str, archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was suspended, and another one builds in the same place by now."""
    file, real = archive.root / NAME / "_receipts/_arrays.lease", getattr(reshard, after)
    taken: list[Lease] = []

    def suspended(*args: Any) -> Any:
        made = real(*args)
        file.unlink()
        taken.append(Lease.take(file, "another"))
        return made

    monkeypatch.setattr(reshard, after, suspended)
    with pytest.raises(LeaseLost, match="was taken over by run another"):
        cut(archive, 6)
    (other,) = taken
    other.drop()
    assert length(archive) == 2
    assert archive.plan().all_fresh


def test_what_another_command_made_since_it_was_planned_is_kept(archive: Pipeline) -> None:
    plan = archive.plan()
    other = archive.with_settings("gaussians.footprint=0.6")
    other.run()
    with pytest.raises(ArchiveError, match="another command changed sequence person meanwhile"):
        reshard.reshard(plan, 6)
    assert other.plan().all_fresh
    plan = other.plan()
    cut(other, 4)
    with pytest.raises(ArchiveError, match="another command changed sequence person meanwhile"):
        reshard.reshard(plan, 6)
    assert other.plan().all_fresh


def test_a_pattern_that_several_sequences_match_is_refused(archive: Pipeline) -> None:
    from posegaussian.dags.cli.maintenance import reshard as command

    shutil.copytree(archive.root / NAME, archive.root / "persona")
    with pytest.raises(ArchiveError, match=r"'person\*' matches 2 sequences, person, persona; name one"):
        command("person*", 3, archive=str(archive.root))
    assert length(archive) == 2


def test_one_that_was_killed_is_begun_anew(archive: Pipeline, finished: Pipeline) -> None:
    lease, half = archive.root / NAME / "_receipts/_arrays.lease", archive.root / "_reshard/new" / NAME / "depth"
    code = (
        "import os; from pathlib import Path; from posegaussian.storage.archive.lease import Lease, own_name;"
        f" Lease.take(Path({str(lease)!r}), own_name('reshard')); os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 9
    half.mkdir(parents=True)
    assert lease.exists()
    cut(archive, 4)
    assert archive.plan().all_fresh
    assert_same_content(content(archive), content(finished))
