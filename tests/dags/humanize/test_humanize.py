"""Numbers for people: as many figures as mean something, whatever their size; and tables that stay tables."""

from __future__ import annotations

import re

import pytest

from posegaussian.dags.evaluation.measured import Number
from posegaussian.dags.evaluation.results import Result
from posegaussian.dags.evaluation.tables import Column
from posegaussian.dags.humanize.latex import latex_text
from posegaussian.dags.humanize.markdown import markdown_table
from posegaussian.dags.humanize.text import gigabytes, seconds_text

SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}
BYTES = {"kB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}


@pytest.mark.parametrize("seconds", [0.94, 30.0, 89.94, 89.96, 90.0, 100.0, 149.0, 599.0, 600.0, 5369.0, 5400.0, 1e6])
def test_seconds_are_told_to_a_twentieth(seconds: float) -> None:
    told, unit = seconds_text(seconds).split()
    assert float(told) * SECONDS[unit] == pytest.approx(seconds, rel=0.05)
    assert float(told) <= 90 or unit == "h"


def test_seconds_are_told_in_the_unit_that_suits() -> None:
    assert [seconds_text(s) for s in (89.9, 89.96, 90, 596, 598, 5400)] == [
        "89.9 s", "1.5 min", "1.5 min", "9.9 min", "10 min", "1.5 h"
    ]  # fmt: skip


@pytest.mark.parametrize("count", [500, 5e4, 9.9e4, 1e5, 3e7, 9.9e7, 1e8, 9e11, 1e12, 1e15])
def test_bytes_are_told_to_a_tenth_and_in_few_figures(count: float) -> None:
    told, unit = gigabytes(count).split()
    assert float(told) * BYTES[unit] == pytest.approx(count, rel=0.1)
    assert len(told) <= 7
    assert gigabytes(-count) == f"-{told} {unit}"


def test_no_number_of_a_table_is_minus_nothing() -> None:
    for unit, told in (("dB", "0.00"), ("1", "0.0000")):
        column = Column(("delta_ssim", "box", "mean"), "x", "", unit)
        result = Result("a", "", "b", {column.key: Number(*column.key, -1e-6, unit, "")})
        assert column.text(result) == told


def test_markdown_stays_a_table_whatever_its_cells_hold() -> None:
    lines = markdown_table(["a", "b|c"], [["x|y\nz", "1"], ["", "|"]])
    assert len(lines) == 4
    assert all(len(re.findall(r"(?<!\\)\|", line)) == 3 for line in lines)
    assert len({len(line) for line in lines}) == 1
    assert "x\\|y z" in lines[2]


def test_latex_reads_no_character_that_its_fonts_lack() -> None:
    told = latex_text("\N{MICRO SIGN} \N{GREEK SMALL LETTER MU} 2 × 3 ≤ 6 ≥ 5 → ± Δ")
    assert told.isascii()
    assert told.count(r"$\mu$") == 2
