"""Imports run one way: dags -> stages -> the data types of storage, and dags -> storage. Nothing runs up."""

from __future__ import annotations

import ast
import tomllib
from functools import cache
from pathlib import Path

import pytest
import setuptools

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("dags", "stages", "storage")
FILES = sorted(f for folder in (*PACKAGES, "tests", "benchmarks") for f in (ROOT / folder).rglob("*.py"))
DATA_TYPES = {
    *(f"storage.{name}" for name in ("spec", "rig", "joints", "timegrid", "errors", "capture", "crop", "splats")),
    *(f"storage.{name}" for name in ("documents", "yaml_documents", "plausible", "home")),
}
"""What stages may know of storage: cameras, time and arrays as data, and how an error is named."""

WRITERS = {"stages/network/weights.py": {"storage.files"}, "stages/capture/bake.py": {"storage.files"}}
"""Modules of stages that leave a file behind, outside any run, and know how one is written whole."""
SCHEDULERS = {"dask", "distributed"}


def name(file: Path) -> str:
    return file.relative_to(ROOT).as_posix()


@cache
def imports(file: Path) -> frozenset[str]:
    """Dotted modules a file imports anywhere in it; `from a import b` counts as a.b where that is a module."""
    found = set()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(file)}:{node.lineno}: relative imports hide the edge (and the code digest does not follow them)"
            assert node.module is not None
            modules = {f"{node.module}.{a.name}" for a in node.names if _is_module(f"{node.module}.{a.name}")}
            found |= modules or {node.module}
    return frozenset(found)


def _is_module(dotted: str) -> bool:
    base = ROOT.joinpath(*dotted.split("."))
    return base.with_suffix(".py").is_file() or base.is_dir()


def top(dotted: str) -> str:
    return dotted.partition(".")[0]


def of(*folders: str) -> list[Path]:
    return [f for f in FILES if f.relative_to(ROOT).parts[0] in folders]


@pytest.mark.parametrize("file", of("storage"), ids=name)
def test_storage_knows_neither_stages_nor_dags_nor_a_scheduler(file: Path) -> None:
    assert not {i for i in imports(file) if top(i) in {"stages", "dags", *SCHEDULERS}}


@pytest.mark.parametrize("file", of("stages"), ids=name)
def test_stages_know_of_storage_only_data_types_and_open_no_store(file: Path) -> None:
    assert not {i for i in imports(file) if top(i) in {"dags", "zarr", "pyarrow", *SCHEDULERS}}
    assert not {i for i in imports(file) if top(i) == "storage"} - DATA_TYPES - WRITERS.get(name(file), set())


def test_the_data_types_of_storage_depend_on_each_other_alone() -> None:
    for module in sorted(DATA_TYPES):
        file = ROOT.joinpath(*module.split(".")).with_suffix(".py")
        assert not {i for i in imports(file) if top(i) == "storage"} - DATA_TYPES, module
        assert not {i for i in imports(file) if top(i) in {"zarr", "pyarrow", "av", "cv2", "torch", "OpenImageIO"}}, module


@pytest.mark.parametrize("file", of(*PACKAGES), ids=name)
def test_nothing_outside_tests_and_benchmarks_imports_them(file: Path) -> None:
    assert not {i for i in imports(file) if top(i) in {"tests", "benchmarks", "pytest", "hypothesis"}}


@pytest.mark.parametrize("file", of("stages", "storage"), ids=name)
def test_no_kernel_loads_a_module_by_name(file: Path) -> None:
    """A module loaded by name is invisible to the code digest; only the contract's `resolve` does so."""
    if name(file) != "stages/contract.py":
        assert not {i for i in imports(file) if top(i) == "importlib" and i != "importlib.metadata"}


@pytest.mark.parametrize("file", [f for f in of(*PACKAGES) if f.name == "__init__.py"], ids=name)
def test_packages_compute_nothing_at_import(file: Path) -> None:
    """A package's `__init__` is not part of the code digest, so it holds a docstring and nothing else."""
    assert all(isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant) for n in ast.parse(file.read_bytes()).body)


@pytest.mark.parametrize("file", FILES, ids=name)
def test_no_file_is_longer_than_500_lines_or_20_kilobytes(file: Path) -> None:
    text = file.read_bytes()
    assert len(text.splitlines()) <= 500
    assert len(text) <= 20_000, f"{name(file)} has {len(text)} bytes"


def test_tests_mirror_packages() -> None:
    for folder in {f.parent for f in of("tests")}:
        assert (folder / "__init__.py").is_file(), f"{name(folder)} has no __init__.py"


def test_a_wheel_holds_the_three_packages_and_their_settings_alone() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = setuptools.find_packages(str(ROOT), include=settings["packages"]["find"]["include"])
    assert {top(package) for package in found} == set(PACKAGES)
    assert {f.parent for f in of(*PACKAGES)} == {ROOT.joinpath(*package.split(".")) for package in found}, "a folder has no __init__.py"
    data = {f for package, globs in settings["package-data"].items() for pattern in globs for f in ROOT.joinpath(*package.split(".")).glob(pattern)}
    others = {f for folder in PACKAGES for f in (ROOT / folder).rglob("*") if f.is_file() and f.suffix != ".py" and f.parent.name != "__pycache__"}
    assert others == data, "files that would be missing from the wheel"
