"""The paper's numbers as it prints them, from the one file that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from posegaussian.storage.model.yaml_documents import read_yaml

PRINTED = Path(__file__).with_name("printed.yaml")
OURS = "Ours"
"""The paper's name of its own method, in every table."""


@dataclass(frozen=True)
class Printed:
    """A table of the paper, or what it prints for a group of rows of an ablation."""

    label: str
    """Where it stands."""
    note: str
    """What a reader should know about it, "" for nothing."""
    rows: Mapping[str, Any]
    """{row: {column: as printed}}; of `table1` by data set, of `table2` by number of cameras within the row."""

    @property
    def measures(self) -> list[str]:
        """Columns of a group of an ablation, in the paper's order."""
        return list(dict.fromkeys(m for row in self.rows.values() for m in row))


def table(name: str) -> Printed:
    """`table1`, `table2`, `table3` or `runtime`."""
    return _printed(_all()[name])


@lru_cache(maxsize=1)
def ablation() -> dict[str, Printed]:
    """{group of `posegaussian ablate`: what the paper prints for its rows}."""
    return {name: _printed(found) for name, found in _all()["ablation"].items()}


def _printed(found: Mapping[str, Any]) -> Printed:
    return Printed(found["label"], found.get("note", ""), found.get("rows", {}))


@lru_cache(maxsize=1)
def _all() -> Mapping[str, Any]:
    return read_yaml(PRINTED)
