"""A remembered status is the one that would be worked out, whatever happened since."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from posegaussian.dags.diagnostics import status
from posegaussian.dags.diagnostics.status import Numbers, numbers, standing
from posegaussian.dags.planning.selection import Selection
from posegaussian.storage.files.write import write_atomically
from tests.support.pipeline import NAME, Pipeline


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


def worked_out(pipeline: Pipeline) -> Numbers:
    return numbers(pipeline.plan())


def shard(pipeline: Pipeline) -> Path:
    return next(p for p in sorted((pipeline.root / NAME / "depth/depth").glob("c.*")))


def change_a_setting(pipeline: Pipeline) -> Pipeline:
    return pipeline.with_settings("gaussians.footprint=0.6")


def delete_a_shard(pipeline: Pipeline) -> Pipeline:
    shard(pipeline).unlink()
    return pipeline


def truncate_a_shard(pipeline: Pipeline) -> Pipeline:
    os.truncate(shard(pipeline), 10)
    return pipeline


def remove_a_receipt(pipeline: Pipeline) -> Pipeline:
    (pipeline.root / NAME / "_receipts/depth/p000001.json").unlink()
    return pipeline


def replace_a_receipt(pipeline: Pipeline) -> Pipeline:
    """By one of the same size, as a run with another setting might."""
    file = pipeline.root / NAME / "_receipts/depth/p000001.json"
    times, text = file.stat(), file.read_bytes()
    write_atomically(file, text.replace(b'"fingerprint": "', b'"fingerprint": "0')[: len(text)])
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    return pipeline


def run_with_other_settings(pipeline: Pipeline) -> Pipeline:
    change_a_setting(pipeline).run(selection=Selection(only=frozenset({"gaussians"})))
    return pipeline


@pytest.mark.parametrize(
    "change",
    [change_a_setting, delete_a_shard, truncate_a_shard, remove_a_receipt, replace_a_receipt, run_with_other_settings],
)
def test_whatever_changes_the_status_is_noticed(archive: Pipeline, change: Callable[[Pipeline], Pipeline]) -> None:
    before = standing(archive.session, NAME)
    assert before == worked_out(archive)
    changed = change(archive)
    assert standing(changed.session, NAME) == worked_out(changed) != before


def test_it_is_worked_out_once(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    first = standing(archive.session, NAME)
    monkeypatch.setattr(status, "numbers", lambda *a: pytest.fail("it was worked out again"))
    assert standing(archive.session, NAME) == first


def test_failures_and_what_they_block_are_counted_apart(archive: Pipeline) -> None:
    remove_a_receipt(archive)
    told = standing(
        archive.session,
        NAME,
        [(NAME, "depth", 1, None, None), (NAME, "depth", 2, None, None), ("another", "depth", 0, None, None)],
    )
    assert {k: told["depth"][k] for k in ("all", "done", "failed", "stale")} == {
        "all": 3,
        "done": 2,
        "failed": 1,
        "stale": 0,
    }, "what is fresh did not fail"
    assert (told["gaussians"]["blocked"], told["gaussians"]["undecided"]) == (1, 0)
    assert told["frames"]["done"] == told["frames"]["all"]


def test_a_code_change_is_noticed(archive: Pipeline, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    standing(archive.session, NAME)
    monkeypatch.setattr(status, "_code", lambda: [tmp_path / "new_module.py"])
    asked = []
    monkeypatch.setattr(status, "numbers", lambda *a: asked.append(1) or {})
    standing(archive.session, NAME)
    assert asked
