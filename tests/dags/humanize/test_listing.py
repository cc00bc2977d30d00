"""Tables for the terminal: no word and no number is broken, however narrow it is."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import cast

import pytest
from rich.console import Console
from rich.table import Table
from rich.text import Text

from posegaussian.dags.humanize.listing import listing
from posegaussian.dags.inspection import inspect
from posegaussian.dags.maintenance import garbage_collection
from posegaussian.dags.maintenance.garbage_collection import Deletable
from posegaussian.stages.inspection.finding import Finding, FindingVerdict
from posegaussian.stages.inspection.report import Report


def printed(table: Table, width: int) -> str:
    out = io.StringIO()
    Console(file=out, width=width, color_system=None).print(table)
    return out.getvalue()


ROWS = [
    ("partners", "cam00 and 3 more", "12 of 12", "[green]good[/]", "at least 2 within 40 degrees"),
    ("outline", "[b]left[/] cam", "0.31 px", "[red]bad[/]", "at most 1.5 px"),
]
HEAD = ("measure", "of", "number", "verdict", "bounds")


@pytest.mark.parametrize("width", [24, 30, 40, 46, 60, 80, 200])
def test_no_word_of_a_listing_is_broken_or_lost(width: int) -> None:
    """At any width, in a table or line by line, in the order of rows and of heads."""
    text = printed(listing(HEAD, ROWS, width, "usable?", whole=("number",)), width)
    lines = text.splitlines()
    assert max(len(line) for line in lines) <= width
    words = [word for line in lines for word in line.split()]
    wanted = [word for row in ROWS for cell in row for word in Text.from_markup(cell).plain.split()]
    assert sorted(w for w in words if set(w) != {"─"}) == sorted(
        [*wanted, "usable?", *(HEAD * (1 if "─" in text else len(ROWS)))]
    )
    for number in ("12 of 12", "0.31 px"):
        assert number in text


def test_a_wide_terminal_has_a_line_a_row_and_a_narrow_one_a_line_a_cell() -> None:
    def lines(width: int) -> list[str]:
        text = printed(listing(HEAD, ROWS, width), width)
        return [" ".join(line.split()) for line in text.splitlines() if line.strip(" ─")]

    assert lines(100)[1] == "partners cam00 and 3 more 12 of 12 good at least 2 within 40 degrees"
    assert lines(38)[:3] == ["measure partners", "of cam00 and 3 more", "number 12 of 12"]


def test_a_word_longer_than_a_column_may_be_is_folded_and_leaves_the_table_one() -> None:
    path = "/".join(["folder"] * 9)
    text = printed(listing(("what", "bytes"), [(path, "1.0 MB")], 60), 60)
    assert "─" in text
    assert "".join(line.split()[0] for line in text.splitlines() if "folder" in line) == path


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_what_inspect_and_gc_print_has_its_words_whole(width: int) -> None:
    bad = Finding("partners", ("cam00",), 12.25, "degrees", 5.0, 9.0, "", "turn it", FindingVerdict.BAD)
    report = cast(Report, SimpleNamespace(findings=(bad,)))
    words = printed(inspect.table("walk", report, width), width).split()
    assert {"partners", "number", "verdict", "degrees", *bad.bounds.split()} <= set(words)
    item = Deletable("arrays", "walk", "refinement/rotation, 1 task", 123456789, "refinement (2 s)", lambda: None)
    told = printed(garbage_collection.table([item], width), width)
    assert {"sequence", "refinement/rotation,", "refinement", "(2", "s)"} <= set(told.split())
    assert "0.12 GB" in told
