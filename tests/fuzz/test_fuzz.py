"""A few of the variants of `make fuzz`, in this process; and what the harness itself must notice."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from posegaussian.storage.model.errors import SourceError
from tests.fuzz import pool
from tests.fuzz.formats import Format, formats
from tests.fuzz.pool import folder_of, run, variant
from tests.fuzz.spoil import spoil

VARIANTS = 4
SLOW = ("scene YAML",)
"""Rows that only `make fuzz` runs: their first variant compiles for long."""
ROWS = [f for f in formats() if f.name not in SLOW]


@pytest.mark.parametrize("row", ROWS, ids=lambda f: f.name)
def test_a_few_variants_work_or_are_refused_with_a_sentence(tmp_path: Path, row: Format) -> None:
    whole = tmp_path / folder_of(row.name)
    row.make(whole)
    for index in range(VARIANTS):
        found = variant(row, index, whole, tmp_path / "place")
        assert found.how in ("accepted", "refused"), found


def written(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "a.json").write_text('{"a": 1}')


def planting(folder: Path, out: Path) -> None:
    (folder.parents[2] / "outside" / "planted").touch()


def hungry(folder: Path, out: Path) -> None:
    _ = b"x" * 300_000_000


def silent(folder: Path, out: Path) -> None:
    raise SourceError("")


def crashing(folder: Path, out: Path) -> None:
    raise KeyError("a")


def endless(folder: Path, out: Path) -> None:
    while True:
        pass


def dying(folder: Path, out: Path) -> None:
    import os

    os._exit(3)


@pytest.mark.parametrize(
    ("use", "how"),
    [
        (planting, "outside"),
        (hungry, "memory"),
        (silent, "traceback"),
        (crashing, "traceback"),
        (lambda folder, out: None, "accepted"),
    ],
)
def test_the_harness_sees_each_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, use: Callable[[Path, Path], object], how: str
) -> None:
    monkeypatch.setattr(pool, "MEMORY", 40_000_000)
    row = Format("a", written, "*.json", "json", use)
    row.make(tmp_path / "whole")
    gc.collect()  # what earlier tests left in this process would be given back meanwhile, and hide what is taken
    assert variant(row, 0, tmp_path / "whole", tmp_path / "place").how == how


def test_a_worker_that_hangs_or_dies_is_a_fault_and_the_others_go_on(tmp_path: Path) -> None:
    rows = [
        Format("hangs", written, "*.json", "json", endless),
        Format("dies", written, "*.json", "json", dying),
        Format("works", written, "*.json", "json", lambda folder, out: None),
    ]
    for row in rows:
        row.make(tmp_path / "whole" / row.name)
    found = list(run(rows, [(r.name, n) for n in range(2) for r in rows], tmp_path, workers=1, seconds=0.3))
    assert [(o.format, o.how) for o in found] == [("hangs", "hang"), ("dies", "died"), ("works", "accepted")] * 2


def test_the_same_number_is_the_same_damage(tmp_path: Path) -> None:
    for kind in ("binary", "pickle", "json", "yaml", "toml", "xml", "table"):
        contents = []
        for _ in range(2):
            written(tmp_path / kind)
            for index in range(5):
                (tmp_path / kind / "a.json").unlink(missing_ok=True)
                (tmp_path / kind / "a.json").write_text('{"a": 1.5, "b": [1, 2]}')
                said = spoil(tmp_path / kind / "a.json", kind, tmp_path, Random(f"x {index + 40}"))
                file = tmp_path / kind / "a.json"
                contents.append((said, file.read_bytes() if file.is_file() else None))
                if file.is_dir():
                    file.rmdir()
            for left in (tmp_path / kind).iterdir():
                left.unlink()
            (tmp_path / kind).rmdir()
        assert contents[:5] == contents[5:]
