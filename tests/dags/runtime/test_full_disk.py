"""Commands on a disk that is full, or becomes so while they work: a sentence, nothing half done, and a way out."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from rich.console import Console

from posegaussian.dags.diagnostics.run_log import RunLog
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.maintenance import garbage_collection
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime import run_registry
from posegaussian.dags.runtime.events import RunEnded, RunStarted
from posegaussian.dags.runtime.run_registry import Presence
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.dags.session.session import Session
from posegaussian.dags.simulation.shipped import scene_file
from posegaussian.dags.simulation.simulate import film, read_scene, stage_scene
from posegaussian.storage.archive import lease
from posegaussian.storage.archive.deletion import folder_bytes
from posegaussian.storage.archive.receipts import missing_files, scan_receipts
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.files import write
from posegaussian.storage.model.errors import NotWritten
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content

BLOCK = 4096
"""Bytes that the smallest file takes."""


class Disk:
    """A disk that holds so much of a folder: what would go beyond finds no room, as leases and files are written.

    With `leases`, so many are granted before that.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, root: Path, room: int, leases: int = 0) -> None:
        self.root, self.size, self.leases = root, folder_bytes(root) + room, leases
        create, sync = lease._create, os.fsync

        def take(file: Path, *more: Any) -> int:
            self.leases -= 1
            self.check(BLOCK)
            return create(file, *more)

        def synced(handle: int) -> None:
            self.check(0)
            sync(handle)

        monkeypatch.setattr(lease, "_create", take)
        monkeypatch.setattr(write.os, "fsync", synced)

    def check(self, more: int) -> None:
        if self.leases <= 0 and folder_bytes(self.root) + more > self.size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    """A copy of the finished archive that may be changed."""
    return finished.copy(tmp_path / "archive")


@pytest.fixture
def full(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> Iterator[Pipeline]:
    """An archive on a disk without room for another byte."""
    Disk(monkeypatch, archive.root, 0)
    yield archive
    monkeypatch.undo()


@pytest.mark.parametrize("kind", ["arrays", "paths"])
def test_gc_frees_a_disk_that_is_full_to_the_last_byte(
    full: Pipeline, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = full.with_settings(*(["rendering.paths=[]"] if kind == "paths" else [])).plan()
    items = [i for i in garbage_collection.items([plan], Archive(full.root)) if i.kind == kind]
    with pytest.raises(NotWritten, match="the disk is full"):
        full.session.run(
            [full.plan(selection=Selection(force=frozenset({"metrics"})))], Selection(force=frozenset({"metrics"}))
        )
    before = folder_bytes(full.root)
    assert garbage_collection.apply(items, [plan]) > 0
    assert folder_bytes(full.root) < before
    assert not list(full.root.rglob("*.lease"))
    assert not list(full.root.rglob("*.partial"))
    sequence = Archive.open(str(full.root)).sequence(NAME)
    assert not [m for r in scan_receipts(sequence) for m in missing_files(sequence, r)], (
        "no receipt promises what is gone"
    )
    monkeypatch.undo()
    if kind == "arrays":
        assert full.plan().all_fresh


def test_gc_that_may_not_make_room_says_so(full: Pipeline) -> None:
    plan = full.plan()
    item = garbage_collection.Deletable("stages", NAME, "nothing", 0, "nothing", lambda: None)
    before = content(full)
    with pytest.raises(NotWritten, match=r"_arrays\.lease: the disk is full"):
        garbage_collection.apply([item], [plan])
    assert_same_content(content(full), before)


def test_a_disk_that_fills_up_in_mid_run_ends_with_the_table(
    archive: Pipeline, finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forced = Selection(start="depth")
    out = io.StringIO()
    session = Session(archive.configuration, str(archive.root), Console(file=out, width=200))
    plan = archive.plan(selection=forced)
    Disk(monkeypatch, archive.root, 0, leases=4)
    assert session.run_and_report([plan], forced) == 1
    monkeypatch.undo()
    said = out.getvalue()
    assert "what failed" in said
    assert "ledger.parquet: the disk is full" in said
    assert "the disk is full" in said
    assert "failed, " in said.splitlines()[-1]
    assert "Traceback" not in said
    assert not list(archive.root.rglob("*.lease"))
    assert not list((archive.root / NAME).rglob("*.partial"))
    archive.run()
    assert_same_content(content(archive), content(finished))


def test_a_disk_that_turns_read_only_in_mid_run_ends_with_the_table(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    import posegaussian.stages.depth.run as depth

    refused = OSError(errno.EROFS, os.strerror(errno.EROFS))

    def from_now_on(inputs: object, params: object) -> None:
        for module, name in ((lease, "_create"), (os, "unlink"), (os, "rename"), (os, "replace")):
            monkeypatch.setattr(module, name, Mock(side_effect=refused))
        monkeypatch.setattr(write.os, "fsync", Mock(side_effect=refused))
        raise refused

    monkeypatch.setattr(depth, "run", from_now_on)
    forced, out = Selection(start="depth"), io.StringIO()
    session = Session(archive.configuration, str(archive.root), Console(file=out, width=200))
    assert session.run_and_report([archive.plan(selection=forced)], forced) == 1
    monkeypatch.undo()
    assert "what failed" in out.getvalue()
    assert "failed, " in out.getvalue().splitlines()[-1]
    for left in archive.root.rglob("*.lease"):
        left.unlink()  # it runs out within a minute
    archive.run()


def test_what_a_killed_run_left_on_a_disk_that_is_read_only_stays(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, there = archive.context().sequence, run_registry.folder(archive.context().sequence)
    left = Presence.of(sequence, RunTerms("killed"))
    run_registry.count_on(sequence, RunTerms("killed"), {})
    os.write(left.lease.last_words(), b"killed")
    with monkeypatch.context() as m:
        m.setattr(os, "unlink", Mock(side_effect=OSError(errno.EROFS, os.strerror(errno.EROFS))))
        run_registry.sweep(sequence, RunTerms("next"))
    assert len(list(there.iterdir())) == 2
    run_registry.sweep(sequence, RunTerms("next"))
    assert not list(there.iterdir())
    left.drop()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs the device that is always full")
def test_a_log_that_cannot_be_written_is_said_once_and_written_when_there_is_room(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "run")
    log.file.parent.mkdir()
    log.file.symlink_to("/dev/full")
    log(RunStarted((), ()))
    log(RunEnded(done=1, fresh=0, failed=0, blocked=0, left_out=0, seconds=1.0, interrupted=False))
    (told,) = log.sentences
    assert told.startswith(
        "the log of this run lacks its last 2 events,"
        " so `status --failed` and the ledger do not know of them: cannot write "
    )
    assert "the disk is full" in told
    log.file.unlink()
    log(RunEnded(done=1, fresh=0, failed=0, blocked=0, left_out=0, seconds=1.0, interrupted=False))
    assert log.sentences == []
    assert log.file.read_text().count("\n") == 3


def test_an_import_that_does_not_fit_leaves_no_sequence(
    person_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipeline = Pipeline(tmp_path / "archive", person_folder)
    settings = pipeline.configuration.for_sequence(NAME)
    capture = find_capture("images", person_folder, [], settings)
    archive = Archive.open(str(tmp_path / "archive"), create=True)
    for copy in (False, True):
        with monkeypatch.context() as m:
            Disk(m, archive.root, 20000 if copy else 0)
            with pytest.raises(NotWritten, match="the disk is full"):
                register(archive, NAME, capture, settings, copy)
        assert not (archive.root / NAME).exists()
    made, _ = register(archive, NAME, capture, settings)
    assert len(made.capture.numbers) == 6


def test_half_a_film_is_no_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = read_scene(scene_file("single_pair"))
    scene = scene.model_copy(update={"frames": 1, "rig": scene.rig.model_copy(update={"size": (48, 48)})})
    staged = stage_scene(scene, tmp_path)
    folder = tmp_path / "capture"
    with monkeypatch.context() as m:
        Disk(m, tmp_path, 3000)
        with pytest.raises(NotWritten, match="the disk is full"):
            film(scene, staged, folder, 1)
    assert not folder.exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs the device that is always full")
def test_an_output_that_cannot_be_written_is_a_sentence(finished: Pipeline) -> None:
    with open("/dev/full", "w") as out:
        done = subprocess.run(
            [sys.executable, "-m", "posegaussian.dags.cli.app", "status", *finished.options],
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr) == (
        2,
        "error: standard output: No space left on device; choose another place, or free this one\n",
    )
