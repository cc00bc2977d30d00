"""`posegaussian --version`, and what else stands before the name of a command."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app


def test_the_version_is_that_of_the_package() -> None:
    done = CliRunner().invoke(app, ["--version"])
    assert (done.exit_code, done.output) == (0, f"posegaussian {version('posegaussian')}\n")


def test_the_help_names_it_and_says_what_this_is_for() -> None:
    done = CliRunner().invoke(app, ["--help"])
    assert "--version" in done.output
    assert "novel views" in done.output


def test_a_shell_completes_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("COMP_WORDS", "posegaussian exp"), ("COMP_CWORD", "1")):
        monkeypatch.setenv(name, value)
    done = CliRunner().invoke(
        app, prog_name="posegaussian", env={"_POSEGAUSSIAN_COMPLETE": "complete_bash"}, standalone_mode=True
    )
    assert done.output.split() == ["export"]


def test_python_runs_the_command_by_the_packages_name() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "posegaussian", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == CliRunner().invoke(app, ["--version"]).stdout
