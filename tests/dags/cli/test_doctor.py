"""`posegaussian doctor`: what is there, what is missing, and the command that mends it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.diagnostics import doctor
from posegaussian.dags.diagnostics.doctor import State

NAMES = ["cores", "memory", "torch", "GPU", "people", "LPIPS", "video in", "video out", "disk", "kernels"]


@pytest.fixture(autouse=True)
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine where no model was fetched, and a folder without settings."""
    monkeypatch.setenv("POSEGAUSSIAN_MODELS", str(tmp_path / "models"))
    monkeypatch.chdir(tmp_path)


def looked_at(*options: str) -> tuple[int, dict[str, dict[str, str]]]:
    done = CliRunner().invoke(app, ["doctor", "--json", *options])
    return done.exit_code, {c["name"]: c for c in map(json.loads, done.stdout.splitlines())}


def test_a_machine_without_models_can_run_and_is_told_the_command() -> None:
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == 0, done.output
    assert "to mend: posegaussian models fetch blazepose" in done.output
    assert "a run is possible; " in done.output
    assert "next: posegaussian import auto FOLDER" in done.output


def test_an_archive_below_a_file_stops_every_run(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    status, checks = looked_at("--archive", str(tmp_path / "file/archive"))
    assert list(checks) == NAMES
    assert status == 1
    assert checks["disk"]["state"] == "stops"
    assert "--archive FOLDER" in checks["disk"]["mend"]


def test_weights_of_lpips_that_are_missing_come_with_the_command_that_brings_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    _, checks = looked_at()
    assert checks["LPIPS"]["state"] == "good"
    assert "`posegaussian models fetch lpips` brings them" in checks["LPIPS"]["found"]
    _, checks = looked_at("--set", "metrics.measures=[psnr, lpips_alex]")
    assert (checks["LPIPS"]["state"], checks["LPIPS"]["mend"]) == ("lacks", "posegaussian models fetch lpips")


def test_files_of_lpips_that_are_not_there_are_named() -> None:
    status, checks = looked_at("--set", "metrics.lpips_weights={alex: gone.pth}")
    assert (status, checks["LPIPS"]["state"]) == (0, "lacks")
    assert "alex (gone.pth)" in checks["LPIPS"]["found"]


def test_little_disk_is_told_before_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    for free, state in ((10**7, State.STOPS), (10**9, State.LACKS), (10**12, State.GOOD)):
        monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _, free=free: type("Usage", (), {"free": free}))
        assert doctor._disk("archive").state is state


def test_a_library_that_cannot_be_loaded_stops_every_run() -> None:
    def broken() -> doctor.Check:
        raise ImportError("libGL.so.1 is missing")

    check = doctor._tried("video in", broken)
    assert check.state is State.STOPS
    assert "libGL.so.1" in check.found
    assert doctor.sentences([check])[-1] == "no run is possible: 1 thing to mend first"
