"""The throughput benchmark: what a command takes with all that it starts, how workers compare, what is run and kept."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import typer.main

from benchmarks.pipeline import night
from benchmarks.processes import Taken, watched
from posegaussian.dags.cli.app import app
from posegaussian.dags.config.settings import RunSettings, load_configuration
from posegaussian.dags.simulation.simulated_run import ARCHIVE

MB = 150
CHILD = f"import time; held = bytearray({MB} * 10**6); time.sleep(1.5)"
PARENT = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {CHILD!r}], check=True)"
BUSY = """
import subprocess, sys
if sys.argv[1:]:
    sum(range(20_000_000))
else:
    subprocess.run([sys.executable, __file__, "again"], check=True)
"""


def test_memory_of_processes_below_counts(tmp_path: Path) -> None:
    taken = watched([sys.executable, "-c", PARENT], tmp_path)
    assert MB < taken.memory < 3 * MB
    assert taken.seconds > 1.5


def test_processor_seconds_of_processes_below_count_and_sleep_does_not(tmp_path: Path) -> None:
    script = tmp_path / "busy.py"
    script.write_text(BUSY)
    asleep = watched([sys.executable, "-c", "import time; time.sleep(0.3)"], tmp_path)
    assert watched([sys.executable, str(script)], tmp_path).cpu > asleep.cpu + 0.1


def test_a_command_that_fails_says_what_it_said(tmp_path: Path) -> None:
    with pytest.raises(subprocess.CalledProcessError) as raised:
        watched([sys.executable, "-c", "print('no such camera'); raise SystemExit(3)"], tmp_path)
    assert raised.value.returncode == 3
    assert "no such camera" in raised.value.__notes__[0]


def test_workers_are_compared_within_a_repeat() -> None:
    """The machine slows down from repeat to repeat; two workers are twice as quick in each."""
    one, two = ([Taken(s / n, 9.0 * n, 100.0 * n, 0.5) for s in (100.0, 200.0, 800.0)] for n in (1, 2))
    cell = night.Cell(1, 8, "512", 10)
    first, second = night.rows(cell, {1: one, 2: two})
    assert (first["times"], second["times"]) == (1.0, 2.0)
    assert (first["frames an hour"], second["frames an hour"]) == (180.0, 360.0)
    assert (second["CPU s a frame"], second["memory MB"]) == (1.8, 200.0)


def test_numbers_of_workers_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []

    def run(folder: Path, workers: int, settings: tuple[str, ...]) -> Taken:
        made.append(workers)
        return Taken(1.0, 1.0, 1.0, 0.0)

    monkeypatch.setattr(night, "run", run)
    monkeypatch.setattr(night, "film_capture", lambda scene, folder: (None, {}))
    monkeypatch.setattr(night, "held_out_setting", lambda staged: "")
    found = night.measured(night.Cell(1, 8, "512", 2), [1, 2], 2, ())
    assert made == [1, 1, 2, 2, 1], "one that does not count, then to and fro"
    assert [len(taken) for taken in found.values()] == [2, 2]


def test_pictures_have_the_size_that_is_named() -> None:
    assert night.Cell(1, 16, "1080p", 3).scene.rig.size == (1920, 1080)
    assert night.Cell(1, 16, "1080p", 3).scene.rig.cameras == 16


def test_a_run_begins_with_an_empty_archive_and_leaves_none(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of the command itself, that it is one."""
    monkeypatch.setattr(night, "SIZES", {"512": (48, 48)})
    archive = tmp_path / ARCHIVE
    seen: list[RunSettings] = []

    def watched(command: list[str], folder: Path) -> Taken:
        typer.main.get_command(app).commands["run"].make_context("run", command[4:])  # type: ignore[attr-defined]
        assert command[:4] == [*night.CLI, "run"]
        assert (folder, command[5], archive.is_dir()) == (tmp_path, str(archive), True)
        seen.append(load_configuration(None, command[7::2], folder=folder).default.run)
        return Taken(2.0, 1.0, 1.0, 0.0)

    monkeypatch.setattr(night, "watched", watched)
    staged, _ = night.film_capture(night.Cell(1, 4, "512", 1).scene, tmp_path)
    for workers in (1, 2):
        assert night.run(tmp_path, workers, (night.held_out_setting(staged), "depth.method=hull")).seconds == 2
        assert not archive.exists()
    assert [(run.workers, run.threads, run.scheduler) for run in seen] == [(1, 1, "local"), (2, 1, "local")]


def test_a_short_night_is_printed_and_not_kept(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("benchmarks.report.RESULTS", tmp_path)
    monkeypatch.setattr(night, "measured", lambda *given: {1: [Taken(36.0, 9.0, 100.0, 0.5)]})
    night.main(["--frames", "2", "--cameras", "8", "--sizes", "1080p"])
    assert capsys.readouterr().out.splitlines()[1].split()[:5] == ["8", "1080p", "2", "1", "200.000"]
    assert not list(tmp_path.iterdir())
    night.main(["--cameras", "8", "--sizes", "512"])
    assert [f.name for f in tmp_path.iterdir()] == ["night.json"]
