"""The code digest of a kernel: what its module and every helper it imports do, not how they are written down.

The digest covers the syntax trees, without docstrings and comments, of the transitive imports of the kernel's module
within `stages` and of the data types of `storage` they use. The declaration language and the scheduler are not part of it.
"""

from __future__ import annotations

import ast
import hashlib
import os
import socket
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from storage.errors import OtherCode

ROOT = Path(__file__).resolve().parent.parent
"""Folder that holds the packages."""

PACKAGES = ("stages", "storage")
"""Packages whose modules count."""

APART = {"stages.contract", "stages.timing"}
"""Modules that declare and do not compute: changing the contract's wording, or how times are taken, changes no result."""


Stamp = tuple[int, int]
"""Modification time in ns and size of a file."""


def stamp_of(file: Path) -> Stamp:
    """The stamp of a file as it is now."""
    stat = file.stat()
    return stat.st_mtime_ns, stat.st_size


KINDS = (".py", ".safetensors", ".npz")
"""Endings of the files that can touch a result: weights that ship are as good as code."""


def own_files(package: str) -> dict[Path, Stamp]:
    """{file: stamp} of the code and data of a package of ours, by name."""
    return {f: stamp_of(f) for f in sorted((ROOT / package).rglob("*")) if f.suffix in KINDS}


STARTED = own_files("dags") | own_files("stages") | own_files("storage")
"""Our files as they were when this process began: what it imported, whatever is edited afterwards."""


def module_file(module: str, root: Path = ROOT) -> Path | None:
    """Source file of a module inside `root`, or None when there is none."""
    base = root.joinpath(*module.split("."))
    return next((f for f in (base.with_suffix(".py"), base / "__init__.py") if f.is_file()), None)


def _blocks(tree: ast.AST) -> Iterator[list[ast.stmt]]:
    """Every list of statements of a module, outermost first; expressions hold none and are not looked into."""
    todo = [tree]
    while todo:
        node = todo.pop()
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, field, None)
            if isinstance(inner, list):
                if field not in ("handlers", "cases"):
                    yield inner
                todo += inner


def _is_text(statement: ast.stmt) -> bool:
    """Whether a statement is a string that stands for itself: a docstring."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant) and isinstance(statement.value.value, str)


@lru_cache(maxsize=4096)
def _parsed(file: str, stamp: Stamp) -> tuple[str, tuple[str, ...]]:
    """(digest of the syntax tree without docstrings, dotted names the module imports)."""
    tree = ast.parse(read_started(Path(file)), file)
    imports: list[str] = []
    for block in _blocks(tree):
        block[:] = [s for s in block if not _is_text(s)]
        for node in block:
            if isinstance(node, ast.Import):
                imports += [a.name for a in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                imports += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
    return hashlib.blake2b(ast.dump(tree).encode(), digest_size=16).hexdigest(), tuple(dict.fromkeys(imports))


def read_started(file: Path) -> bytes:
    """Content of a file, which is that of this process's start where it is one of ours. Raises OtherCode."""
    check_started(file)
    content = file.read_bytes()
    check_started(file)
    return content


def check_started(file: Path) -> None:
    """Raise OtherCode for a file of ours that was edited or removed since this process began, so that nobody knows what it imported."""
    was = STARTED.get(file)
    try:
        now = stamp_of(file)
    except FileNotFoundError:
        now = None
    if was is not None and now != was:
        how = "removed" if now is None else "edited"
        raise OtherCode(f"{file.relative_to(ROOT)} was {how} since {here_is()} began; start it again")


def here_is() -> str:
    """`process P on H`."""
    return f"process {os.getpid()} on {socket.gethostname()}"


def parsed(file: Path) -> tuple[str, tuple[str, ...]]:
    """(digest of a file's syntax tree, dotted names it imports).

    Of this process's own files as they were when it began, even if they are edited later: it goes on with what it imported.
    Raises OtherCode for one that was edited before it was ever read. Others are read again when they changed.
    """
    return _parsed(str(file), STARTED.get(file) or stamp_of(file))


def closure(module: str, root: Path = ROOT, packages: tuple[str, ...] = PACKAGES) -> Iterator[tuple[str, str]]:
    """(module, digest) of a module and of everything it imports within some packages, each once."""
    seen: set[str] = set()
    todo = [module]
    while todo:
        name = todo.pop()
        file = module_file(name, root)
        if name in seen or name in APART or name.partition(".")[0] not in packages or file is None:
            continue
        seen.add(name)
        tree_digest, imports = parsed(file)
        yield name, tree_digest
        todo += imports


def code_digest(run: str, root: Path = ROOT) -> str:
    """Digest of a kernel `module:function`; the Python version counts because syntax trees differ between versions."""
    parts = [f"{name}={d}" for name, d in sorted(closure(run.partition(":")[0], root))]
    text = "\n".join([f"{sys.version_info.major}.{sys.version_info.minor}", *parts])
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
