"""What the documentation shows can be used as it stands: settings are valid, commands parse, what it names is there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer.main

from posegaussian.dags.cli.app import app
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.simulation.simulate import read_scene
from posegaussian.dags.training.config import load_training

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
INDEX = ROOT / "docs/index.md"
WIDTH = 120
"""Most characters of a line of prose."""
PLACEHOLDER = "NAME"
"""Stands for a name of the reader's own in a path."""

LINK = re.compile(r"\]\(([^)\s]+)\)")
PATH = re.compile(r"(?<![\w/.:-])(?:(?:posegaussian/)?(?:dags|stages|storage)|tests|benchmarks|docs)/[\w./-]*\w")
"""A file or folder of the repository, wherever it is named."""
SYMBOL = re.compile(r"`(\w+)`\s+(?:in|of)\s+`([\w/]+\.py)`")
"""`name` in `file`: a function, class or constant and where it is."""
DOTTED = re.compile(
    r"(?<![\w/.])posegaussian\.(?:dags|stages|storage)(?:\.\w+)+|(?<=python -m )(?:benchmarks|tests)(?:\.\w+)+"
)
PAGE_IN_CODE = re.compile(r"(?<![\w/.-])docs/[\w/]+\.(?:md|png|svg)\b")


def named(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, language: str) -> list[str]:
    """Contents of the fenced blocks of a language, "" for none."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [text for language_of, text in found if language_of == language]


def commands(page: Path) -> list[str]:
    """Every `posegaussian COMMAND ...` of a shell block or between backticks; capitals stand for a name."""
    text = page.read_text(encoding="utf-8")
    shell = [block.replace("\\\n", " ") for block in blocks(page, "")]
    lines = [line.split(" #")[0] for block in shell for line in block.splitlines()]
    spans = re.findall(r"`(posegaussian [^`]+)`", text.replace("\n", " "))
    return [line[line.index("posegaussian ") :].strip() for line in (*lines, *spans) if "posegaussian " in line]


def identified(value: object) -> str:
    return named(value) if isinstance(value, Path) else ""


@pytest.mark.parametrize(("page", "block"), [(p, b) for p in PAGES for b in blocks(p, "yaml")], ids=identified)
def test_settings_are_valid(page: Path, block: str, tmp_path: Path) -> None:
    """A block that starts with a seed is a scene, one that starts with a preset a training, else a configuration."""
    file = tmp_path / "pipeline.yaml"
    file.write_text(block)
    read = {"seed": read_scene, "preset": load_training}.get(block.partition(":")[0], load_configuration)
    read(file)


@pytest.mark.parametrize(("page", "line"), [(p, c) for p in PAGES for c in commands(p)], ids=identified)
def test_commands_parse(page: Path, line: str) -> None:
    _, name, *words = shlex.split(line)
    commands_by_name = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    assert name in commands_by_name, f"{named(page)}: {line}"
    command = commands_by_name[name]
    words = ["1" if w == "N" else w for w in words]
    missing = words == [] and any(p.required for p in command.params)
    if not missing:  # a command that is only named, not used
        command.make_context(name, words)


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(page: Path) -> Iterator[str]:
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        target, _, anchor = link.partition("#")
        if ":" in target:  # another site
            continue
        file = page.parent / target if target else page
        if not file.exists():
            yield f"{named(page)} links to {target}, which is not there"
        elif anchor and anchor not in anchors(file):
            yield f"{named(page)} links to {link}, where no heading is named so"


def test_links_lead_somewhere() -> None:
    faults = [fault for page in (*PAGES, ROOT / "CHANGELOG.md") for fault in broken_links(page)]
    assert not faults, "\n".join(faults)


def absent(path: str) -> bool:
    """Whether a path of the repository is not there; behind a placeholder only the folder is asked for."""
    parts = path.split("/")
    known = next((i for i, part in enumerate(parts) if PLACEHOLDER in part), len(parts))
    return not ROOT.joinpath(*parts[:known]).exists()


def module_of(dotted: str) -> tuple[Path | None, str]:
    """The file that a dotted name begins with, and the name behind it; None where there is no such module."""
    parts = dotted.split(".")
    for known in range(len(parts), 0, -1):
        file = ROOT.joinpath(*parts[:known]).with_suffix(".py")
        if file.is_file():
            return file, parts[known] if known < len(parts) else ""
        if (file.with_suffix("") / "__main__.py").is_file() and known == len(parts):
            return file.with_suffix("") / "__main__.py", ""
    return None, ""


def defines(file: Path, name: str) -> bool:
    return (
        re.search(rf"^(?:def|class)\s+{name}\b|^{name}\b.*=", file.read_text(encoding="utf-8"), re.MULTILINE)
        is not None
    )


def missing_code(page: Path) -> Iterator[str]:
    text = page.read_text(encoding="utf-8")
    yield from (f"{named(page)} names {path}, which is not there" for path in PATH.findall(text) if absent(path))
    for name, path in SYMBOL.findall(text):
        if not absent(path) and not defines(ROOT / path, name):
            yield f"{named(page)} names {name} in {path}, where it is not defined"
    for dotted in DOTTED.findall(text):
        file, name = module_of(dotted)
        if file is None or (name and not defines(file, name)):
            yield f"{named(page)} names {dotted}, which is not there"


def test_files_and_code_it_names_are_there() -> None:
    faults = [fault for page in PAGES for fault in missing_code(page)]
    assert not faults, "\n".join(faults)


def test_pages_that_the_code_names_are_there() -> None:
    """A line with an address speaks of somebody else's pages."""
    folders = ("dags", "stages", "storage", "tests", "benchmarks")
    files = [f for folder in folders for kind in ("*.py", "*.yaml") for f in (ROOT / folder).rglob(kind)]
    faults = [
        f"{named(file)} names {page}"
        for file in (ROOT / "Makefile", *files)
        for line in file.read_text(encoding="utf-8").splitlines()
        if "://" not in line
        for page in PAGE_IN_CODE.findall(line)
        if not (ROOT / page).is_file()
    ]
    assert not faults, "\n".join(faults)


def test_the_index_leads_to_every_page() -> None:
    linked = {
        (INDEX.parent / target.partition("#")[0]).resolve()
        for target in LINK.findall(INDEX.read_text(encoding="utf-8"))
    }
    assert not [named(page) for page in PAGES if page not in linked and page != INDEX]


def prose(page: Path) -> Iterator[tuple[int, str]]:
    """Numbered lines outside of fenced blocks and tables."""
    fenced = False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        fenced ^= line.startswith("```")
        if not fenced and not line.startswith("|"):
            yield number, line


def test_lines_of_prose_end_at_their_width() -> None:
    faults = [
        f"{named(p)}:{n} has {len(line)} characters, at most {WIDTH}"
        for p in PAGES
        for n, line in prose(p)
        if len(line) > WIDTH
    ]
    assert not faults, "\n".join(faults)


def test_the_glossary_is_in_alphabetical_order() -> None:
    rows = (ROOT / "docs/glossary.md").read_text(encoding="utf-8").splitlines()
    words = [row.split("|")[1].strip().lower() for row in rows if row.startswith("| ")][2:]
    assert len(words) > 30
    assert words == sorted(words)
