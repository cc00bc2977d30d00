"""What computes: the code and the libraries of a process that may touch a byte, as one digest and by name.

Every task carries the digest of the run's driver, and a worker compares it with its own before it computes. It is taken
once a process and says what the process imported: a file that was edited since the process began is refused by name.
"""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from pathlib import Path

from posegaussian.dags.provenance.code_digest import (
    ROOT,
    STARTED,
    check_started,
    closure,
    here_is,
    module_file,
    read_started,
)
from posegaussian.dags.provenance.syntax import PACKAGE
from posegaussian.storage.model.errors import OtherCode
from posegaussian.storage.model.spec import digest

LIBRARIES = {
    name: name
    for name in (
        "numpy",
        "zarr",
        "numcodecs",
        "torch",
        "av",
        "numba",
        "llvmlite",
        "OpenImageIO",
        "pyarrow",
        "safetensors",
    )
} | {
    "opencv-contrib-python-headless": "cv2",
    "ai-edge-litert": "ai_edge_litert",
}
"""{library that can touch a result: what it is imported as}."""

EXECUTOR = "posegaussian.dags.runtime.executors.dask_worker"
"""Module whose imports are all of `dags` that a task goes through."""

EDITED = "files were edited since the run began: run again"
"""Advice about a process of our own that is of another build."""

NAMED = 4
"""Differences a sentence names; the others are counted."""


@dataclass(frozen=True)
class Build:
    """The code and the libraries of one process."""

    versions: dict[str, str]
    """Digest of every file of ours and version of every library, by name."""
    digest: str
    """Of all of them."""


@lru_cache(maxsize=1)
def here() -> Build:
    """What this process imported, or will: taken once.
    Raises OtherCode when one of its files was edited since it began."""
    executor = [file for name, _ in closure(EXECUTOR, folders=("dags",)) if (file := module_file(name)) is not None]
    files = sorted({*executor, *(f for f in STARTED if f.relative_to(ROOT).parts[0] != "dags")})
    code = {f.relative_to(ROOT).as_posix(): hashlib.blake2b(read_started(f), digest_size=8).hexdigest() for f in files}
    versions = code | libraries()
    return Build(versions, digest(versions))


@lru_cache(maxsize=1)
def libraries() -> dict[str, str]:
    """{library: version, or absent}; builds of one version, such as those for a kind of device, count as one."""
    return {name: _version(name) for name in LIBRARIES} | {"python": platform.python_version()}


def _version(name: str) -> str:
    try:
        return version(name).partition("+")[0]
    except PackageNotFoundError:
        return "absent"


def differences(there: Mapping[str, str]) -> str:
    """What another process has otherwise than this one, libraries first."""
    own = here().versions
    names = [n for n in sorted({*there, *own}, key=lambda n: (n in own and "/" in n, n)) if there.get(n) != own.get(n)]
    said = [_difference(n, there.get(n), own.get(n)) for n in islice(names, NAMED)]
    return ", ".join(said) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")


def objection(who: str, versions: Mapping[str, str], advice: str) -> str:
    """Sentence about a process that is of another build than this one."""
    return f"{who} has other code or libraries than this run: {differences(versions)}; {advice}"


def _difference(name: str, there: str | None, here: str | None) -> str:
    if there is None or here is None:
        return f"{name} is missing {'there' if there is None else 'here'}"
    return f"{name} ({there} there, {here} here)"


_checked: set[str] = set()
"""Modules of ours that were found to be imported as they were when the process began."""
_loaded = 0
"""Modules of the interpreter at the last look."""


def check_imports() -> None:
    """Raise OtherCode when what was imported since the last call is not what the digest was taken of.

    Kernels and libraries are imported when their first task comes, which may be hours after that.
    """
    global _loaded
    if len(sys.modules) == _loaded:
        return
    count = len(sys.modules)
    for name, module in list(sys.modules.items()):
        if name not in _checked and name.partition(".")[0] == PACKAGE and (file := getattr(module, "__file__", None)):
            check_started(Path(file).resolve())
            _checked.add(name)
    for library, name in LIBRARIES.items():
        loaded = str(getattr(sys.modules.get(name), "__version__", "")).partition("+")[0]
        if not libraries()[library].startswith(loaded):
            raise OtherCode(
                f"{library} {libraries()[library]} is installed, but {here_is()} has {loaded} in memory; start it again"
            )
    _loaded = count


def refuse_other(wanted: str, worker: str) -> None:
    """Raise OtherCode, with all versions of this process, unless its digest is the one that is wanted.

    Args:
        wanted: digest of the run's driver.
        worker: address of the worker this process is.
    """
    try:
        own = here()
    except OtherCode as e:
        raise OtherCode(str(e), worker) from None
    if own.digest != wanted:
        raise OtherCode("the code or the libraries of this worker are not those of the run", worker, own.versions)
