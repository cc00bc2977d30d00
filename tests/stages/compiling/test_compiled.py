"""Kernels kept on disk: taken as long as nothing that went into them has changed, compiled anew as soon as it has."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FILES = {
    "inner.py": """
from posegaussian.stages.compiling.compiled import compiled

@compiled
def scaled(x):
    return 2 * x
""",
    "middle.py": """
from posegaussian.stages.compiling.compiled import compiled
from people.inner import scaled

@compiled
def moved(x):
    return scaled(x) + 1
""",
    "numbers.py": """
import numpy as np

MARGIN = 10
TABLE = np.array([100, 200])
""",
    "intrinsics.py": """
from numba import types
from numba.extending import intrinsic

@intrinsic
def constant(typing):
    def code(context, builder, signature, arguments):
        return context.get_constant(signature.return_type, 1000)
    return types.int64(), code
""",
    "unkept.py": """
from numba import njit

@njit
def three():
    return 3
""",
    "outer.py": """
from posegaussian.stages.compiling.compiled import compiled
from people import middle
from people.intrinsics import constant
from people.numbers import MARGIN, TABLE
from people.unkept import three

@compiled(error_model="numpy")
def outer(x):
    return middle.moved(x) + MARGIN + TABLE[0] + constant() + three()

def note():
    return "nothing that is compiled"
""",
    "__init__.py": "",
}
RUN = """
from people.outer import outer
print(outer(3), sum(outer.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package whose one kernel uses another's kernel, which uses a third's, one that is not kept, a number, a table
    and an intrinsic."""
    (tmp_path / "people").mkdir()
    for name, text in FILES.items():
        (tmp_path / "people" / name).write_text(text)
    return tmp_path


def called(folder: Path) -> tuple[int, int]:
    """(what the outermost kernel makes of 3, how often it was loaded from disk) in a process of its own."""
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}
    variables |= {"NUMBA_CACHE_DIR": str(folder / "kernels"), "PYTHONDONTWRITEBYTECODE": "1"}
    out = subprocess.run([sys.executable, "-c", RUN], env=variables, text=True, capture_output=True, check=True).stdout
    value, hits = map(int, out.split())
    return value, hits


def edit(folder: Path, name: str, old: str, new: str) -> None:
    file = folder / "people" / name
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))


def test_what_is_unchanged_is_loaded(package: Path) -> None:
    assert called(package) == (1120, 0)
    assert called(package) == (1120, 1)


@pytest.mark.parametrize(
    ("name", "old", "new", "value"),
    [
        ("inner.py", "2 * x", "5 * x", 1129),
        ("middle.py", "+ 1", "+ 2", 1121),
        ("numbers.py", "10\n", "20\n", 1130),
        ("numbers.py", "[100", "[300", 1320),
        ("intrinsics.py", "1000", "7000", 7120),
        ("unkept.py", "return 3", "return 4", 1121),
    ],
    ids=["the kernel of a kernel", "a kernel of a module", "a number", "a table", "an intrinsic", "a kernel not kept"],
)
def test_what_another_module_puts_in_is_never_what_it_was(
    package: Path, name: str, old: str, new: str, value: int
) -> None:
    called(package)
    edit(package, name, old, new)
    assert called(package) == (value, 0)
    assert called(package) == (value, 1)


def test_options_count() -> None:
    from posegaussian.stages.compiling.compiled import compiled

    def half(x: float) -> float:
        return x / 2

    stamps = [compiled(**o)(half)._cache._cache_file._source_stamp for o in ({}, {}, {"error_model": "numpy"})]
    assert stamps[0] == stamps[1] != stamps[2]
