"""The code digest of a kernel: what its module and every helper it imports do, not how they are written down.

The digest covers the syntax trees, without docstrings and comments, of the transitive imports of the kernel's module
within `stages` and of the data types of `storage` they use. The declaration language and the scheduler are not part of
it.
"""

from __future__ import annotations

import hashlib
import os
import socket
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from posegaussian.dags.provenance.syntax import PACKAGE, Syntax, remembered, syntax_of
from posegaussian.storage.model.errors import OtherCode

ROOT = Path(__file__).resolve().parents[2]
"""Folder that holds dags, stages and storage: the repository, or the installed package."""

FOLDERS = ("stages", "storage")
"""Folders whose modules count."""

APART = {"posegaussian.stages.contract.declaration", "posegaussian.stages.contract.timing"}
"""Modules that declare and do not compute:
changing the contract's wording, or how times are taken, changes no result."""


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
    """Source file of a module inside `root`, or None when there is none; of our own as of when this process began."""
    if root == ROOT:
        return _own_module(module)
    return next((Path(f) for f in _candidates(module, root) if os.path.isfile(f)), None)


@lru_cache(maxsize=4096)
def _own_module(module: str) -> Path | None:
    return next((f for f in map(Path, _candidates(module, ROOT)) if f in STARTED), None)


@lru_cache(maxsize=65536)
def _candidates(module: str, root: Path) -> tuple[str, ...]:
    """Where the source of a module could be."""
    package, *parts = module.split(".")
    if package != PACKAGE or not parts:
        return ()
    base = os.path.join(root, *parts)
    return f"{base}.py", os.path.join(base, "__init__.py")


@lru_cache(maxsize=4096)
def _parsed(file: str, stamp: Stamp) -> Syntax:
    """The syntax of a file as it was at a stamp; of our own remembered from one process to the next."""
    path = Path(file)
    return (remembered().of if path in STARTED else syntax_of)(read_started(path), file)


def read_started(file: Path) -> bytes:
    """Content of a file, which is that of this process's start where it is one of ours. Raises OtherCode."""
    check_started(file)
    content = file.read_bytes()
    check_started(file)
    return content


def check_started(file: Path) -> None:
    """Raise OtherCode for a file of ours that was edited or removed since this process began, so that nobody knows
    what it imported."""
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


def parsed(file: Path) -> Syntax:
    """(digest of a file's syntax tree, dotted names it imports).

    Of this process's own files as they were when it began, even if they are edited later: it goes on with what it
    imported. Raises OtherCode for one that was edited before it was ever read. Others are read again when they changed.
    """
    return _parsed(str(file), STARTED.get(file) or stamp_of(file))


def closure(module: str, root: Path = ROOT, folders: tuple[str, ...] = FOLDERS) -> Iterator[tuple[str, str]]:
    """(module, digest) of a module and of everything it imports within some of our folders, each once.

    A module is known by what it and the modules it imports hold, not by their names: one that only moved has the same
    digest.
    """
    known: dict[str, Syntax | None] = {}

    def syntax(name: str) -> Syntax | None:
        if name not in known:
            inside = any(name.startswith(f"{PACKAGE}.{folder}.") for folder in folders)
            file = module_file(name, root) if inside and name not in APART else None
            known[name] = None if file is None else parsed(file)
        return known[name]

    seen: set[str] = set()
    todo = [module]
    while todo:
        name = todo.pop()
        if name in seen or (of_name := syntax(name)) is None:
            continue
        seen.add(name)
        own, imports = of_name
        edges = {i: of_import[0] for i in imports if (of_import := syntax(i)) is not None}
        yield name, hashlib.blake2b("\n".join([own, *edges.values()]).encode(), digest_size=16).hexdigest()
        todo += edges


def code_digest(run: str, root: Path = ROOT) -> str:
    """Digest of a kernel `module:function`; the Python version counts because syntax trees differ between versions."""
    module = run.partition(":")[0]
    return _own_digest(module) if root == ROOT else _digest(module, root)


@lru_cache(maxsize=256)
def _own_digest(module: str) -> str:
    """Of our own code as it was when this process began, which stays what it is."""
    found = _digest(module, ROOT)
    remembered().keep()
    return found


def _digest(module: str, root: Path) -> str:
    parts = sorted(d for _, d in closure(module, root))
    text = "\n".join([f"{sys.version_info.major}.{sys.version_info.minor}", *parts])
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
