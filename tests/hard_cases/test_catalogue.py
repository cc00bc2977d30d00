"""The page, the records and the tests hold the same cases, and every bound of the page holds."""

import ast
import re
from pathlib import Path

import pytest

from tests.hard_cases.catalogue import Case, catalogue, holds, run
from tests.hard_cases.stability import PAGE, PICTURE, page

FOLDER = Path(__file__).parent
NAMES = [c.name for c in catalogue()]


@pytest.mark.parametrize("case", catalogue(), ids=lambda c: c.name)
def test_the_bound_holds_and_the_naive_version_breaks_it(case: Case) -> None:
    assert holds(case), run(case)


def test_every_case_has_a_test_that_bears_its_name() -> None:
    found = set()
    for file in FOLDER.glob("test_*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef) and (said := re.match(r"test_((?:[skrdpl]\d+b?_)+)", node.name)):
                found |= {n.upper().replace("B", "b") for n in said[1].strip("_").split("_")}
    assert found == set(NAMES)


def test_names_are_unique_and_no_case_of_the_catalogue_is_missing() -> None:
    assert len(set(NAMES)) == len(NAMES)
    assert {
        f"{kind}{i}"
        for kind, count in (("S", 22), ("K", 6), ("D", 15), ("P", 7), ("L", 10))
        for i in range(1, count + 1)
    } <= set(NAMES)


def test_the_page_lists_exactly_the_cases_with_their_words_and_bounds() -> None:
    """What was measured depends on the machine; all else is what the records say now."""

    def stable(text: str) -> list[list[str]]:
        rows = [
            [cell.strip() for cell in line.strip("|").split("|")]
            for line in text.splitlines()
            if re.match(r"\| [SKRDPL]\d", line)
        ]
        return [[*row[:2], *row[4:5], *row[6:]] for row in rows]

    assert stable(PAGE.read_text(encoding="utf-8")) == stable(page({}))
    assert PICTURE.exists()
