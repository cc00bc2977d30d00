"""Every hard case names lines that are there and could be broken; the check itself tells what is caught from what is
not. `make mutations` breaks them all."""

from __future__ import annotations

import pytest

from tests.hard_cases.catalogue import catalogue
from tests.mutations import broken_import
from tests.mutations.__main__ import tried, verdict
from tests.mutations.guard import Edit, Guard, guards_of
from tests.mutations.registry import ALL, GUARDS


def test_every_case_of_the_catalogue_has_a_guard_and_every_guard_a_case() -> None:
    assert set(GUARDS) == {c.name for c in catalogue()}


@pytest.mark.parametrize("guard", ALL, ids=lambda g: f"{g.case}-{g.edits[0].file}")
def test_guarded_lines_stand_in_the_code_once_and_are_broken_by_other_python(guard: Guard) -> None:
    for edit in guard.edits:
        assert edit.broken != edit.line
    assert len(guard.sources()) == len({e.file for e in guard.edits})


def test_no_two_guards_break_the_same_thing() -> None:
    assert len(set(ALL)) == len(ALL)


def test_a_line_that_is_gone_is_told_with_its_case() -> None:
    with pytest.raises(ValueError, match=r"S1 guards a line that stands in storage/model/masks\.py 0 times: 'gone'"):
        guards_of("S1")("storage/model/masks.py", "gone", "here").sources()
    with pytest.raises(SyntaxError):
        guards_of("S1")("storage/model/masks.py", "FOREGROUND = 127", "FOREGROUND = = 127").sources()


def test_a_case_is_run_against_the_broken_line_in_a_process_of_its_own() -> None:
    assert tried("K4", 0) == (True, "error 0.08, bound 0")


def test_what_counts_as_caught() -> None:
    assert verdict({"error": float("nan"), "bound": 1.0})[0]
    assert verdict({"raised": "AssertionError"})[0]
    assert not verdict({"error": 1.0, "bound": 1.0})[0]
    assert verdict({"broken": "NameError: x"}) == (False, "nothing was tried: NameError: x")


def test_what_is_imported_already_cannot_be_broken() -> None:
    with pytest.raises(ValueError, match="imported already"):
        broken_import.install({Edit("storage/model/masks.py", "", "").module: ""})
