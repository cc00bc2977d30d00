"""Imports run one way: dags -> stages -> the data types of storage, and dags -> storage.
Nothing runs up, nothing in a circle."""

from __future__ import annotations

import ast
import statistics
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import setuptools

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "posegaussian"
FOLDERS = ("dags", "stages", "storage")
FILES = sorted(f for folder in (*FOLDERS, "tests", "benchmarks") for f in (ROOT / folder).rglob("*.py"))
MODEL = "storage.model"
"""What stages may know of storage: cameras, time and arrays as data, and how an error is named."""
SCHEDULERS = {"dask", "distributed"}
LIBRARIES = (
    "compiling",
    "simulator",
    "following",
    "geometry",
    "silhouettes",
    "camera_paths",
    "imaging",
    "matching",
    "splatting",
    "estimators",
)
"""Folders of stages that are no stage: what several stages compute with."""
ONE_KIND = (
    "storage/importers",
    "stages/simulator/effects",
    "stages/depth/methods",
    "stages/metrics/measures",
    "stages/survey/measures",
)
"""Folders of one registered kind, where every file is another one of it: they may hold any number."""
MOST_MODULES = 15


def name(file: Path) -> str:
    return file.relative_to(ROOT).as_posix()


@cache
def imports(file: Path) -> frozenset[str]:
    """Dotted modules a file imports anywhere in it, ours without `posegaussian.`; `from a import b` counts as a.b
    where that is a module."""
    found = set()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, (
                f"{name(file)}:{node.lineno}: relative imports hide the edge (and the code digest does not follow them)"
            )
            assert node.module is not None
            modules = {f"{node.module}.{a.name}" for a in node.names if _is_module(f"{node.module}.{a.name}")}
            found |= modules or {node.module}
    return frozenset(i.removeprefix(f"{PACKAGE}.") for i in found)


def _is_module(dotted: str) -> bool:
    base = ROOT.joinpath(*dotted.split("."))
    return base.with_suffix(".py").is_file() or base.is_dir()


def top(dotted: str) -> str:
    return dotted.partition(".")[0]


def of(*folders: str) -> list[Path]:
    return [f for f in FILES if f.relative_to(ROOT).parts[0] in folders]


def dotted(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts)


def inside(module: str, folder: str) -> bool:
    return module == folder or module.startswith(f"{folder}.")


def offenders(files: Iterable[Path], forbidden: Iterable[str]) -> list[str]:
    """`file imports module` for every import of something that lies in a forbidden folder or package."""
    told = tuple(forbidden)
    return [f"{name(f)} imports {i}" for f in files for i in sorted(imports(f)) if any(inside(i, t) for t in told)]


def test_storage_knows_neither_stages_nor_dags_nor_a_scheduler() -> None:
    assert not offenders(of("storage"), ("stages", "dags", *SCHEDULERS))


def test_stages_know_of_storage_the_model_alone_and_open_no_store() -> None:
    assert not offenders(of("stages"), ("dags", "zarr", "pyarrow", *SCHEDULERS))
    assert not [
        f"{name(f)} imports {i}"
        for f in of("stages")
        for i in sorted(imports(f))
        if top(i) == "storage" and not inside(i, MODEL)
    ]


def test_the_model_depends_on_itself_alone_and_on_no_codec() -> None:
    files = [f for f in of("storage") if inside(dotted(f), MODEL)]
    assert len(files) > 5
    assert not [
        f"{name(f)} imports {i}"
        for f in files
        for i in sorted(imports(f))
        if top(i) == "storage" and not inside(i, MODEL)
    ]
    assert not offenders(files, ("zarr", "pyarrow", "av", "cv2", "torch", "OpenImageIO"))


def test_libraries_of_stages_know_no_stage() -> None:
    allowed = (*(f"stages.{library}" for library in LIBRARIES), "stages.contract")
    files = [f for f in of("stages") if any(inside(dotted(f), f"stages.{library}") for library in LIBRARIES)]
    assert len(files) > 30
    wrong = [
        f"{name(f)} imports {i}"
        for f in files
        for i in sorted(imports(f))
        if top(i) == "stages" and not any(inside(i, a) for a in allowed)
    ]
    assert not wrong


def test_planning_and_runtime_know_of_stages_what_these_declare() -> None:
    """What generic code asks of a single stage, the stage's declaration answers."""
    files = [f for f in of("dags") if inside(dotted(f), "dags.planning") or inside(dotted(f), "dags.runtime")]
    assert len(files) > 25
    assert not [
        f"{name(f)} imports {i}"
        for f in files
        for i in sorted(imports(f))
        if inside(i, "stages") and not (inside(i, "stages.contract") or i == "stages.registry")
    ]


def test_no_folder_and_no_file_is_part_of_a_circle() -> None:
    files = {dotted(f): {i for i in imports(f) if top(i) in FOLDERS} for f in of(*FOLDERS) if f.name != "__init__.py"}
    assert not list(circles({module: {t for t in targets if t in files} for module, targets in files.items()}))
    folders: dict[str, set[str]] = {}
    for module, targets in files.items():
        own = module.rpartition(".")[0]
        folders.setdefault(own, set()).update(
            t.rpartition(".")[0] for t in targets if t in files and t.rpartition(".")[0] != own
        )
    assert not list(circles(folders))


def test_a_circle_is_found() -> None:
    assert [sorted(c) for c in circles({"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set()})] == [["a", "b", "c"]]


def circles(edges: dict[str, set[str]]) -> Iterator[list[str]]:
    """Sets of nodes that reach each other, each once."""
    reach: dict[str, set[str]] = {}
    for start in edges:
        todo, seen = list(edges[start]), set()
        while todo:
            node = todo.pop()
            if node not in seen:
                seen.add(node)
                todo += edges.get(node, ())
        reach[start] = seen
    told: set[str] = set()
    for node in sorted(edges):
        group = [other for other in sorted(reach[node]) if other in reach and node in reach[other]]
        if group and node not in told:
            told.update(group)
            yield group


def test_nothing_outside_tests_and_benchmarks_imports_them() -> None:
    assert not offenders(of(*FOLDERS), ("tests", "benchmarks", "pytest", "hypothesis"))


def test_ours_are_imported_from_the_package_alone() -> None:
    """A module that is also imported as `dags.x` would be two modules."""
    for file in FILES:
        for node in ast.walk(ast.parse(file.read_bytes())):
            modules = (
                [a.name for a in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else []
            )
            assert not [m for m in modules if top(m) in FOLDERS], f"{name(file)}:{node.lineno}"


def test_no_kernel_loads_a_module_by_name() -> None:
    """A module loaded by name is invisible to the code digest; only the contract's `resolve` does so."""
    files = [f for f in of("stages", "storage") if name(f) != "stages/contract/declaration.py"]
    assert not [
        f"{name(f)} imports {i}"
        for f in files
        for i in imports(f)
        if top(i) == "importlib" and i != "importlib.metadata"
    ]


def test_packages_compute_nothing_at_import() -> None:
    """A package's `__init__` is not part of the code digest, so it holds a docstring and nothing else."""
    for file in (f for f in of(*FOLDERS) if f.name == "__init__.py"):
        body = ast.parse(file.read_bytes()).body
        assert body, f"{name(file)} says nothing"
        assert all(isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant) for n in body), name(file)


def test_files_and_folders_are_small() -> None:
    texts = {name(f): f.read_bytes() for f in FILES}
    assert not [
        f"{n} has {len(t)} bytes, {len(t.splitlines())} lines"
        for n, t in texts.items()
        if len(t.splitlines()) > 500 or len(t) > 20_000
    ]
    assert (
        statistics.median(
            len(t) for n, t in texts.items() if top(n.replace("/", ".")) in FOLDERS and not n.endswith("__init__.py")
        )
        < 5_000
    )
    crowded = {}
    for folder in {f.parent for f in of(*FOLDERS)}:
        count = sum(f.suffix == ".py" and f.name != "__init__.py" for f in folder.iterdir())
        if count > MOST_MODULES and name(folder) not in ONE_KIND:
            crowded[name(folder)] = count
    assert not crowded


def test_tests_mirror_packages() -> None:
    assert not [name(folder) for folder in {f.parent for f in of("tests")} if not (folder / "__init__.py").is_file()]


def test_a_wheel_holds_one_package_and_its_settings_alone() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = setuptools.find_packages(str(ROOT), include=settings["packages"]["find"]["include"])
    assert {top(package) for package in found} == {PACKAGE}
    linked = {ROOT.joinpath(*package.split(".")).resolve() for package in found} - {ROOT / PACKAGE}
    assert {f.parent for f in of(*FOLDERS)} == linked, "a folder has no __init__.py"
    data = {
        f.resolve()
        for package, globs in settings["package-data"].items()
        for pattern in globs
        for f in ROOT.joinpath(*package.split(".")).glob(pattern)
    }
    others = {
        f
        for folder in FOLDERS
        for f in (ROOT / folder).rglob("*")
        if f.is_file() and f.suffix != ".py" and f.parent.name != "__pycache__"
    }
    assert others == data, "files that would be missing from the wheel"
