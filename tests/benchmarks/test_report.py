"""A kept result says what it was measured on, and no digit that does not hold."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from benchmarks import report


def test_a_result_says_code_day_machine_and_versions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = {"rev-parse": "a1b2c3", "status": "M benchmarks/results/made.json"}
    monkeypatch.setattr(report, "_git", lambda command, *words: answers[command])
    monkeypatch.setattr(report, "RESULTS", tmp_path / "results")
    report.publish("made", [{"what": "a", "s": 1.23456789, "n": 123456}], {"share": np.float64(0.123456)}, shown=False)
    found = json.loads((tmp_path / "results" / "made.json").read_text())
    assert found["rows"] == [{"what": "a", "s": 1.235, "n": 123456}] == report.kept("made")
    assert found["settings"] == {"share": 0.1235}
    assert found["commit"] == "a1b2c3"
    assert found["changed"] is False, "what is measured is written while measuring, it is not the code"
    assert abs(datetime.now(UTC) - datetime.fromisoformat(found["date"])) < timedelta(minutes=1)
    assert found["date"].endswith("+00:00")
    assert all(found["machine"][fact] for fact in ("processor", "cores", "memory GiB"))
    assert {"python", "numpy", "torch", "numba", "zarr"} <= set(found["versions"])


def test_a_result_of_changed_code_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "_git", lambda *words: " M benchmarks/results/made.json\n M stages/depth/run.py")
    assert report.provenance()["changed"] is True


def test_outside_a_checkout_the_commit_is_not_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    monkeypatch.setattr(report, "ROOT", tmp_path)
    monkeypatch.setattr(report, "_libraries", dict)
    found = report.provenance()
    assert found["commit"] is found["changed"] is None


@pytest.mark.parametrize(
    ("value", "kept"),
    [
        (276.82728999, 276.8),
        (0.00012345678, 0.0001235),
        (-5.334449, -5.334),
        (143909.6, 143910.0),
        (9.99996, 10.0),
        (0.0, 0.0),
        (12, 12),
        (True, True),
        (None, None),
        ("", ""),
        (math.inf, math.inf),
    ],
)
def test_numbers_are_kept_to_four_digits_and_whole_units(value: object, kept: object) -> None:
    assert report.rounded({"a": [value]}) == {"a": [kept]}
    assert type(report.rounded(value)) is type(kept)
