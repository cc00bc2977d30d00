"""Commands on archives of many sequences: what is said of each, and what is not worked out for each."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.cli.run import IN_FULL
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.forecast import History, project, together
from posegaussian.dags.session import session as sessions
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import Pipeline

TITLE = "projected, at most"


def many(folder: Path, archive: Path, count: int) -> Pipeline:
    """An archive of so many sequences of one capture, `s00` on."""
    pipeline = Pipeline(archive, folder)
    settings = pipeline.configuration.default
    for n in range(count):
        capture = find_capture("images", folder, [], settings)
        register(Archive.open(str(archive), create=True), f"s{n:02d}", capture, settings)
    return pipeline


def said(*words: str, archive: Pipeline) -> str:
    done = CliRunner().invoke(app, [*words, *archive.options], env={"COLUMNS": "100"})
    assert done.exit_code == 0, done.output
    return done.output


def test_up_to_ten_sequences_are_planned_in_full_and_more_in_a_line_each(person_folder: Path, tmp_path: Path) -> None:
    archive = many(person_folder, tmp_path / "archive", IN_FULL)
    in_full = said("plan", archive=archive)
    assert in_full.count(TITLE) == IN_FULL
    assert re.findall(r"^ *(s\d\d): 6 frames in 3 partitions", in_full, re.MULTILINE) == [
        f"s{n:02d}" for n in range(IN_FULL)
    ]
    archive = many(person_folder, tmp_path / "archive", IN_FULL + 1)
    names = [f"s{n:02d}" for n in range(IN_FULL + 1)]
    in_short = said("plan", archive=archive)
    tasks = len(archive.session.plan("s00", sessions.Selection()).to_make)
    rows = re.findall(rf"^ (s\d\d) +6 +{tasks}/{tasks} +\S+ \S?B \(guess\) +\S+ \w+ \(guess\)", in_short, re.MULTILINE)
    assert rows == names
    assert in_short.count(TITLE) == 1
    (total,) = re.findall(r"^ all +(\d+)", in_short, re.MULTILINE)
    assert int(total) == tasks * len(names)
    *_, one, following = in_short.splitlines()
    assert one.startswith("one in full, or all with -v: posegaussian plan --sequence s00 --archive")
    assert following.startswith("next: posegaussian run --archive")
    assert said("plan", "-v", archive=archive).count(TITLE) == len(names)
    assert said("plan", "--sequence", "s0?", archive=archive).count(TITLE) == IN_FULL


def test_together_sequences_take_the_sum_and_a_task_of_any_the_most(finished: Pipeline, tmp_path: Path) -> None:
    short, long = (Pipeline(tmp_path / name, finished.folder, partition=n) for name, n in (("a", 1), ("b", 6)))
    found = []
    for pipeline in (short, long):
        pipeline.register()
        found.append({p.stage: p for p in project(pipeline.plan(), History())})
    for p in together([list(f.values()) for f in found]):
        a, b = (f[p.stage] for f in found)
        assert (p.tasks, p.disk, p.peak, p.replaced) == (a.tasks + b.tasks, a.disk + b.disk, a.peak + b.peak, 0)
        assert p.seconds == pytest.approx(a.seconds + b.seconds)
        assert (p.ram, p.vram) == (max(a.ram, b.ram), max(a.vram, b.vram))
        assert (p.timed, p.compressed) == ("guess", False)


def test_a_status_of_sequences_that_nothing_was_made_of_is_worked_out_once(
    person_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = many(person_folder, tmp_path / "archive", 2)
    first = said("status", archive=archive)

    def planned(*_: object) -> None:
        raise AssertionError("a plan was made")

    monkeypatch.setattr(sessions, "make_plan", planned)
    assert said("status", archive=archive) == first
