"""`@compiled`: a function that numba compiles, is kept on disk, and is compiled anew when anything in it has changed.

numba writes whatever a function uses of other modules into its machine code: functions that it inlines, and numbers.
Yet it takes what it kept as long as the function's own file is what it was, so that after an update a kernel could go
on with the inner loop of the version before. Here what a module imported counts too.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numba import njit

NUMBERS = (bool, int, float, complex, str, bytes, np.generic)
"""What a function takes the value of, once and for all, when it is compiled."""


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """A function for numba to compile when it is first called, without Python and without its lock; further options
    are those of `numba.njit`."""
    if function is None:
        return lambda f: compiled(f, **options)
    kernel = njit(cache=True, nogil=True, **options)(function)
    if hasattr(kernel, "_cache"):  # not where NUMBA_DISABLE_JIT leaves a function as it is
        kept = kernel._cache._cache_file  # numba has no other place to say what a kernel is made from
        kept._source_stamp = (kept._source_stamp, _digest(function, options))
    return kernel


def _digest(function: Callable[..., Any], options: dict[str, Any]) -> str:
    """Of the options, and of what the function's module has taken from others of its package by now."""
    package = function.__module__.partition(".")[0]
    names = {name: value for name, value in function.__globals__.items() if not name.startswith("__")}
    parts = [f"{name} {part}" for name, value in names.items() for part in _parts(value, package)]
    return hashlib.sha256("\n".join([repr(sorted(options.items())), *sorted(parts)]).encode()).hexdigest()


def _parts(value: Any, package: str) -> Iterator[str]:
    """What a name of a module says about the machine code of its functions: a number itself; of a kernel all that it
    is made from, in turn; of anything else from a module of the package that module's file."""
    if isinstance(value, NUMBERS):
        yield repr(value)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    elif isinstance(value, tuple | list):
        for inner in value:
            yield from _parts(inner, package)
    elif isinstance(value, ModuleType):
        if _is_of(value.__name__, package):
            yield _file_digest(value.__name__)
            yield from (f"{name} {stamp}" for name, v in vars(value).items() if (stamp := _stamp(v)) is not None)
    elif (stamp := _stamp(value)) is not None:
        yield repr(stamp)
    elif _is_of(getattr(value, "__module__", None), package):
        yield _file_digest(value.__module__)


def _stamp(value: Any) -> Any:
    """What a kernel that is kept is made from; None of anything else."""
    return getattr(getattr(getattr(value, "_cache", None), "_cache_file", None), "_source_stamp", None)


def _is_of(module: Any, package: str) -> bool:
    return isinstance(module, str) and module.partition(".")[0] == package


@cache
def _file_digest(module: str) -> str:
    return hashlib.sha256(Path(str(sys.modules[module].__file__)).read_bytes()).hexdigest()
