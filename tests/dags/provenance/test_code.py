"""The code digest: blind to comments and docstrings, sees every other edit in the kernel and in whatever it imports.

Real edits are made in a copy of the two packages; the repository's files are never touched.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

from posegaussian.dags.provenance.code_digest import APART, ROOT, closure, code_digest, module_file
from posegaussian.stages.registry import STAGES

TICK = count(2_000_000_000_000_000_000, 1_000_000_000)
"""Modification times: digests are read again when a file's time or size changes, and a clock's tick may be coarse."""


def write(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")
    os.utime(file, ns=(now := next(TICK), now))


KERNEL = '''"""Module docstring."""
from posegaussian.stages.k.helper import scale
import posegaussian.storage.bits

LIMIT = 3

class Box:
    """Docstring."""

    size: int = 1
    """Docstring of a field."""

def run(inputs, params):
    """Docstring."""
    # a comment
    for x in inputs:
        yield scale(x) * LIMIT
'''
HELPER = '"""Docstring."""\nfrom posegaussian.stages.k import deep\n\n\ndef scale(x):\n    return deep.scale(x)\n'
DEEP = "def scale(x):\n    from posegaussian.stages.lazy import two\n    return two * x\n"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    files = {
        "stages/k/run.py": KERNEL,
        "stages/k/helper.py": HELPER,
        "stages/k/deep.py": DEEP,
        "stages/lazy.py": "two = 2\n",
        "storage/bits.py": "bits = 8\n",
        "stages/other.py": "x = 1\n",
        "dags/no.py": "x = 1\n",
    }
    for name, text in files.items():
        write(tmp_path / name, text)
    return tmp_path


def test_the_closure_is_everything_imported_within_the_packages_each_once(tree: Path) -> None:
    write(tree / "stages/lazy.py", "import posegaussian.stages.k.run, numpy, posegaussian.dags.no\ntwo = 2\n")
    assert sorted(name for name, _ in closure("posegaussian.stages.k.run", tree)) == [
        "posegaussian.stages.k.deep",
        "posegaussian.stages.k.helper",
        "posegaussian.stages.k.run",
        "posegaussian.stages.lazy",
        "posegaussian.storage.bits",
    ]


COSMETIC = {
    "a comment": lambda s: s.replace("# a comment", "# another comment, longer"),
    "a comment at the end": lambda s: s + "# the end\n",
    "every docstring": (
        lambda s: s.replace("Docstring", "Other words").replace("Module docstring.", "Other.\n\nLonger.")
    ),
    "a docstring that goes": lambda s: s.replace('    """Docstring."""\n    # a', "    # a"),
    "whitespace": lambda s: s.replace("scale(x) * LIMIT", "scale( x )  *  LIMIT").replace("\n\n", "\n\n\n\n"),
    "brackets and quotes that mean nothing": lambda s: s.replace("scale(x) * LIMIT", "(scale(x) * LIMIT)"),
    "line endings": lambda s: s.replace("\n", "\r\n"),
}


@pytest.mark.parametrize("edit", COSMETIC)
def test_a_cosmetic_edit_keeps_the_digest(tree: Path, edit: str) -> None:
    before = code_digest("posegaussian.stages.k.run:run", tree)
    edited = COSMETIC[edit](KERNEL)
    assert edited != KERNEL
    write(tree / "stages/k/run.py", edited)
    assert code_digest("posegaussian.stages.k.run:run", tree) == before


REAL = {
    "a constant": ("stages/k/run.py", "LIMIT = 3", "LIMIT = 4"),
    "an integer that becomes a float": ("stages/k/run.py", "LIMIT = 3", "LIMIT = 3.0"),
    "an operator": ("stages/k/run.py", "scale(x) * LIMIT", "scale(x) + LIMIT"),
    "an order of operands": ("stages/k/run.py", "scale(x) * LIMIT", "LIMIT * scale(x)"),
    "a name": ("stages/k/run.py", "class Box", "class Bag"),
    "a helper's body": ("stages/k/helper.py", "return deep.scale(x)", "return deep.scale(x) + 1"),
    "a helper's helper": ("stages/k/deep.py", "two * x", "x * two"),
    "an import inside a function": ("stages/lazy.py", "two = 2", "two = 3"),
    "a storage type": ("storage/bits.py", "8", "9"),
    "a text that is no docstring": ("storage/bits.py", "bits = 8", "bits = 'eight'"),
}


@pytest.mark.parametrize("edit", REAL)
def test_an_edit_of_the_code_anywhere_changes_the_digest(tree: Path, edit: str) -> None:
    file, old, new = REAL[edit]
    before = code_digest("posegaussian.stages.k.run:run", tree)
    text = (tree / file).read_text()
    assert old in text
    write(tree / file, text.replace(old, new))
    changed = code_digest("posegaussian.stages.k.run:run", tree)
    assert changed != before
    write(tree / file, text)
    assert code_digest("posegaussian.stages.k.run:run", tree) == before


def test_a_file_that_nobody_imports_does_not_count(tree: Path) -> None:
    before = code_digest("posegaussian.stages.k.run:run", tree)
    write(tree / "stages/other.py", "x = 2\n")
    write(tree / "dags/no.py", "x = 2\n")
    assert code_digest("posegaussian.stages.k.run:run", tree) == before


def test_moving_code_into_a_new_helper_changes_the_digest(tree: Path) -> None:
    before = code_digest("posegaussian.stages.k.run:run", tree)
    write(tree / "stages/k/new.py", "")
    write(tree / "stages/k/run.py", KERNEL + "import posegaussian.stages.k.new\n")
    assert code_digest("posegaussian.stages.k.run:run", tree) != before


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("code")
    for package in ("stages", "storage"):
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    return root


def test_a_copy_of_the_code_has_the_same_digests(copied: Path) -> None:
    for stage in STAGES:
        assert code_digest(stage.run, copied) == code_digest(stage.run)


def test_every_edit_of_every_module_changes_exactly_the_stages_that_import_it(copied: Path) -> None:
    members = {s.name: {name for name, _ in closure(s.run.partition(":")[0], copied)} for s in STAGES}
    before = {s.name: code_digest(s.run, copied) for s in STAGES}
    assert all(members.values()), members
    files = {m: file for m in sorted(set().union(*members.values())) if (file := module_file(m, copied)) is not None}
    assert set(files) == set().union(*members.values())
    texts = {module: file.read_text(encoding="utf-8") for module, file in files.items()}
    for module, file in files.items():
        write(file, texts[module] + "\n# a comment\n")
    assert {s.name: code_digest(s.run, copied) for s in STAGES} == before, "comments changed a digest"
    for module, file in files.items():
        text = texts[module]
        write(file, text + "\nEDITED = True\n")
        changed = {s.name for s in STAGES if code_digest(s.run, copied) != before[s.name]}
        write(file, text)
        assert changed == {name for name, of_stage in members.items() if module in of_stage}, module


def test_what_a_kernel_really_imports_is_in_its_closure() -> None:
    """The interpreter's own list of loaded modules, against the one read from syntax trees."""
    code = """
import importlib, json, sys
found = {}
for module in sys.argv[1:]:
    for name in [n for n in sys.modules if n.startswith(("posegaussian.stages.", "posegaussian.storage."))]:
        del sys.modules[name]
    importlib.import_module(module)
    found[module] = [
        n
        for n, m in sys.modules.items()
        if n.startswith(("posegaussian.stages.", "posegaussian.storage.")) and not hasattr(m, "__path__")
    ]
print(json.dumps(found))
"""
    modules = [s.run.partition(":")[0] for s in STAGES]
    loaded = json.loads(
        subprocess.run(
            [sys.executable, "-c", code, *modules], capture_output=True, text=True, check=True, cwd=ROOT
        ).stdout
    )
    contract = {name for apart in APART for name in _imports_of_contract(apart)}
    for module in modules:
        assert set(loaded[module]) - contract <= {name for name, _ in closure(module)}, module


def _imports_of_contract(module: str) -> set[str]:
    """Modules apart and what they import themselves: declarations that compute nothing."""
    from posegaussian.dags.provenance.code_digest import parsed

    file = module_file(module)
    assert file is not None
    return {module, *(i for i in parsed(file)[1] if i.startswith(("posegaussian.stages.", "posegaussian.storage.")))}


def test_the_check_of_a_stage_is_covered_by_its_digest() -> None:
    for stage in STAGES:
        if stage.check is not None:
            assert stage.check.partition(":")[0] in {name for name, _ in closure(stage.run.partition(":")[0])}, (
                stage.name
            )
