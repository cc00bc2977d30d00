"""What the documentation shows can be used as it stands: settings are valid, commands parse, files it names are
there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer.main

from posegaussian.dags.cli.app import app
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.simulation.simulate import read_scene
from posegaussian.dags.training.config import load_training

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])


def blocks(page: Path, language: str) -> list[str]:
    """Contents of the fenced blocks of a language, "" for none."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [text for named, text in found if named == language]


def commands(page: Path) -> list[str]:
    """Every `posegaussian COMMAND ...` of a block of shell lines or between backticks; words in capitals stand for
    something."""
    text = page.read_text(encoding="utf-8")
    lines = [line.split(" #")[0] for block in blocks(page, "") for line in block.splitlines()]
    spans = re.findall(r"`(posegaussian [^`]+)`", text.replace("\n", " "))
    return [line[line.index("posegaussian ") :].strip() for line in (*lines, *spans) if "posegaussian " in line]


@pytest.mark.parametrize(
    ("page", "block"),
    [(p, b) for p in PAGES for b in blocks(p, "yaml")],
    ids=lambda v: v.name if isinstance(v, Path) else "",
)
def test_settings_are_valid(page: Path, block: str, tmp_path: Path) -> None:
    """A block that starts with a seed is a scene, one that starts with a preset a training, any other one a
    configuration."""
    file = tmp_path / "pipeline.yaml"
    file.write_text(block)
    read = {"seed": read_scene, "preset": load_training}.get(block.partition(":")[0], load_configuration)
    read(file)


@pytest.mark.parametrize(
    ("page", "line"), [(p, c) for p in PAGES for c in commands(p)], ids=lambda v: v.name if isinstance(v, Path) else ""
)
def test_commands_parse(page: Path, line: str) -> None:
    _, name, *words = shlex.split(line)
    commands_by_name = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    assert name in commands_by_name, f"{page.name}: {line}"
    command = commands_by_name[name]
    words = ["1" if w == "N" else w for w in words]
    missing = words == [] and any(p.required for p in command.params)
    if not missing:  # a command that is only named, not used
        command.make_context(name, words)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_files_it_names_are_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"
