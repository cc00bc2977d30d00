"""What `--help` says: everything that is written, brackets and all, and examples that the command takes."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer.main
from rich.text import Text
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.training.config import load_training


def walk(command: Any, *names: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command by its words."""
    yield names, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from walk(inner, *names, name)


COMMANDS = dict(walk(typer.main.get_command(app)))


def written(text: str) -> str:
    """A text of the sources as it is to be read; a bracket that is no markup is escaped there."""
    return text.replace("\\[", "[")


def examples(command: Any) -> list[str]:
    """The command lines of its examples."""
    return written(command.help or "").split("Example: ")[1:]


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_nothing_of_a_help_is_taken_for_markup(names: tuple[str, ...]) -> None:
    command = COMMANDS[names]
    for text in [command.help or "", *(getattr(p, "help", None) or "" for p in command.params)]:
        assert Text.from_markup(text).plain == written(text)


@pytest.mark.parametrize("names", [n for n, c in COMMANDS.items() if examples(c)], ids=" ".join)
def test_help_shows_its_examples_in_full_and_the_command_takes_them(names: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(app, [*names, "--help"])
    assert shown.exit_code == 0
    for line in examples(COMMANDS[names]):
        assert "".join(line.split()) in "".join(shown.output.split())
        words = shlex.split(line.partition(" > ")[0])
        assert tuple(words[1 : 1 + len(names)]) == names
        COMMANDS[names].make_context(names[-1], words[1 + len(names) :])


@pytest.mark.parametrize("name", ["train", "ablate"])
def test_trainings_give_a_setting_of_theirs_as_example(name: str) -> None:
    (text,) = (p.help for p in COMMANDS[name,].params if "--set" in p.opts)
    setting = text.partition("for example --set ")[2].partition(" ")[0]
    key, _, value = setting.partition("=")
    assert str(getattr(load_training(None, [setting]), key)) == value
