"""The code digest of a kernel: what its module and every helper it imports do, not how they are written down.

The digest covers the syntax trees, without docstrings and comments, of the transitive imports of the kernel's module
within `stages` and of the data types of `storage` they use. The declaration language and the scheduler are not part of it.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""Folder that holds the packages."""

PACKAGES = ("stages", "storage")
"""Packages whose modules count."""

APART = {"stages.contract", "stages.timing"}
"""Modules that declare and do not compute: changing the contract's wording, or how times are taken, changes no result."""


def module_file(module: str, root: Path = ROOT) -> Path | None:
    """Source file of a module inside `root`, or None when there is none."""
    base = root.joinpath(*module.split("."))
    return next((f for f in (base.with_suffix(".py"), base / "__init__.py") if f.is_file()), None)


def _strip_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [s for s in body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant) and isinstance(s.value.value, str))]  # type: ignore[attr-defined]
    return tree


@lru_cache(maxsize=4096)
def _parsed(file: str, stamp: tuple[int, int]) -> tuple[str, tuple[str, ...]]:
    """(digest of the syntax tree, dotted names the module imports)."""
    tree = ast.parse(Path(file).read_bytes(), file)
    imports: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports += [a.name for a in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            imports += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
    text = ast.dump(_strip_docstrings(tree))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest(), tuple(dict.fromkeys(imports))


def parsed(file: Path) -> tuple[str, tuple[str, ...]]:
    """(digest of a file's syntax tree, dotted names it imports); read again only when the file changed."""
    stat = file.stat()
    return _parsed(str(file), (stat.st_mtime_ns, stat.st_size))


def closure(module: str, root: Path = ROOT) -> Iterator[tuple[str, str]]:
    """(module, digest) of a module and of everything it imports within PACKAGES, each once."""
    seen: set[str] = set()
    todo = [module]
    while todo:
        name = todo.pop()
        file = module_file(name, root)
        if name in seen or name in APART or name.partition(".")[0] not in PACKAGES or file is None:
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
