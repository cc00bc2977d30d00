"""One moment: what many sequences ask of the disk alike is looked at once, as long as a command judges them all."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

T = TypeVar("T")

_SEEN: ContextVar[dict[Hashable, Any] | None] = ContextVar("seen", default=None)


@contextmanager
def one_moment() -> Iterator[None]:
    """Within, `once` asks once: what is judged there is judged as of now. A moment within a moment is the same one."""
    if _SEEN.get() is not None:
        yield
        return
    token = _SEEN.set({})
    try:
        yield
    finally:
        _SEEN.reset(token)


def once(what: Hashable, ask: Callable[[], T]) -> T:
    """What `ask` says; of one moment the first answer about `what`."""
    seen = _SEEN.get()
    if seen is None:
        return ask()
    if what not in seen:
        seen[what] = ask()
    return seen[what]
