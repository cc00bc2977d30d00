"""Pickles that hold nothing but data, and `.npy` files of one object, which are pickles inside.

Python's own unpickler calls whatever a file names. The one here is no unpickler but a reader of the same instructions:
it makes numbers, texts, lists, tuples, dictionaries and arrays of numpy, has no way to call anything, and refuses a
file that asks for more by the name it asks for. Instructions: pickletools of Python; protocols 0 to 5, those of
Python 2 and of numpy before and after 2.0 alike.
"""

from __future__ import annotations

import pickletools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from posegaussian.storage.formats.plain_npy import header
from posegaussian.storage.model.documents import (
    DEEPEST,
    MEGABYTE,
    MOST_DIGITS,
    MOST_VALUES,
    read_bytes,
    reader_of,
    shortened,
    too_deep,
)
from posegaussian.storage.model.errors import SourceError

LARGEST = 64 * MEGABYTE
"""Bytes of a pickle: names and joints of hours of many cameras."""
MOST_STEPS = 1_500_000
"""Instructions of a pickle; a number, a text or a name takes one to three."""
MOST_AXES = 8
"""Axes of an array."""
WEIGHT = 8
"""What a value takes of `MOST_VALUES`, where a number of an array takes 1."""

MOST_TEXTS = 1_000_000
"""Texts of one array."""

RECONSTRUCT, SCALAR, FROM_BUFFER = "_reconstruct", "scalar", "_frombuffer"
DTYPE, NDARRAY, ENCODE, NO_BYTES = "dtype", "ndarray", "encode", "bytes"
KNOWN = {
    "numpy.ndarray": NDARRAY,
    "numpy.dtype": DTYPE,
    "_codecs.encode": ENCODE,
    "__builtin__.bytes": NO_BYTES,
    **{
        f"numpy.{core}.{place}": what
        for core in ("core", "_core")
        for place, what in (
            ("multiarray._reconstruct", RECONSTRUCT),
            ("multiarray.scalar", SCALAR),
            ("numeric._frombuffer", FROM_BUFFER),
        )
    },
}
"""Names that a file may ask for; each stands for what numpy writes, and none is ever looked up."""


@dataclass(frozen=True)
class _Name:
    """One of `KNOWN`."""

    what: str


class _Kind:
    """A dtype while its file says it."""

    def __init__(self, text: str) -> None:
        self.dtype = np.dtype(text) if text[:1] in "fiubUSO" and text[1:].isdigit() else None
        if self.dtype is None:
            raise ValueError(f"it holds an array of {shortened(text)}; numbers and texts are read")

    def build(self, state: Any) -> None:
        """Take over the order of bytes."""
        version, order, *fields = state
        if not isinstance(version, int) or order not in ("<", ">", "|", "=") or any(f is not None for f in fields[:3]):
            raise ValueError("it holds an array of records; numbers and texts are read")
        assert self.dtype is not None
        self.dtype = self.dtype.newbyteorder(order)


class _Array:
    """An array while its file says it: numbers as they are, texts and objects as lists."""

    def __init__(self) -> None:
        self.value: Any = None

    def build(self, state: Any) -> None:
        """Take over shape and numbers, of which there must be as many as the shape says."""
        _, shape, kind, columns, data = state
        self.fill(data, kind, shape, "F" if columns else "C")

    def fill(self, data: Any, kind: Any, shape: Any, order: Any) -> None:
        """Numbers and texts come as bytes, objects as a list."""
        if not isinstance(kind, _Kind) or order not in ("C", "F"):
            raise ValueError("it holds an array without a kind")
        if not isinstance(shape, tuple) or len(shape) > MOST_AXES or not all(type(n) is int and n >= 0 for n in shape):
            raise ValueError(f"it holds an array whose shape is not up to {MOST_AXES} whole numbers")
        count = 1
        for n in shape:
            count *= n
        dtype = kind.dtype
        assert dtype is not None
        if dtype.kind == "O":
            if not isinstance(data, list) or len(data) != count or order == "F":
                raise ValueError(f"it holds an array of shape {shape} with other than {count} objects")
            self.value = data[0] if shape == () else data
            return
        raw = data.encode("latin1") if isinstance(data, str) else data
        if not isinstance(raw, bytes | bytearray) or len(raw) != count * dtype.itemsize:
            raise ValueError(f"it holds an array of shape {shape} of {dtype} with other than its bytes")
        found = np.frombuffer(raw, dtype).reshape(shape, order=order)
        if dtype.kind in "US" and count > MOST_TEXTS:
            raise ValueError(f"it holds an array of {count} texts, at most {MOST_TEXTS} are read")
        self.value = found if dtype.kind in "fiub" else found.tolist() if count else []


def read_pickle(path: str | Path, what: str, largest: int = LARGEST) -> Any:
    """The plain values of a pickle of at most `largest` bytes: None, bool, int, float, str, bytes, list, dict with keys
    of text or whole numbers, and arrays of numbers as np.ndarray. Tuples and arrays of objects are lists.

    Texts of Python 2 are read as latin1. Raises SourceError, naming the file: for whatever else it asks for, by name,
    for more values or levels than are read, and where it is damaged.
    """
    return _loaded(read_bytes(path, what, largest), path, what)


def read_object(path: str | Path, what: str, largest: int = LARGEST) -> Any:
    """The one object of a `.npy` file that `np.save` made of a dictionary or a list; as `read_pickle` otherwise."""
    raw = read_bytes(path, what, largest)
    found, start = header(raw, f"{what} {path}")
    if found["kind"] != "|O" or found["shape"].strip():
        raise SourceError(
            f"cannot read {what} {path}: it holds ({found['shape']}) of {found['kind']}, one object () of |O is"
            " expected; is it another file of the data set?"
        )
    return _loaded(raw[start:], path, what)


def _loaded(raw: bytes, path: str | Path, what: str) -> Any:
    with reader_of(path, what):
        found = _run(raw, f"cannot read {what} {path}")
    return _Plain(path).of(found).value


class _Copy(NamedTuple):
    """A value as it is handed out."""

    value: Any
    weight: int
    """What it and all in it take of `MOST_VALUES`, each place counted as often as it is referred to."""
    height: int
    """Levels of lists and dictionaries in it."""


class _Plain:
    """Values without what only a pickle has. What is referred to many times is looked at once: a kilobyte of references
    to references may stand for more values than any memory holds."""

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._known: dict[int, _Copy] = {}

    def of(self, value: Any, depth: int = 0) -> _Copy:
        """A copy. Raises SourceError for too many values and levels, and for a name in the place of a value."""
        if isinstance(value, _Array):
            value = value.value
        if isinstance(value, _Name | _Kind):
            raise SourceError(f"{self._path} holds a name of numpy in the place of a value; it is damaged")
        if not isinstance(value, dict | list | tuple):
            return _Copy(value, value.size if isinstance(value, np.ndarray) else WEIGHT, 0)
        found = self._known.get(id(value))
        if depth + (found.height if found else 0) > DEEPEST:
            raise SourceError(too_deep(self._path))
        if found is None:
            parts = [self.of(v, depth + 1) for v in (value.values() if isinstance(value, dict) else value)]
            plain = [p.value for p in parts]
            weight = WEIGHT + sum(p.weight for p in parts)
            if weight > MOST_VALUES:
                raise SourceError(f"{self._path} holds more than {MOST_VALUES} values; split it by camera or in time")
            copy = dict(zip(value, plain, strict=True)) if isinstance(value, dict) else plain
            found = self._known[id(value)] = _Copy(copy, weight, 1 + max((p.height for p in parts), default=0))
        return found


def _scalar(kind: Any, data: Any) -> Any:
    one = _Array()
    one.fill(data, kind, (), "C")
    return one.value.item() if isinstance(one.value, np.ndarray) else one.value


def _made(name: Any, given: Any) -> Any:
    """What numpy would make of the arguments of a name."""
    what = name.what if isinstance(name, _Name) else None
    if what == RECONSTRUCT and given[0] == _Name(NDARRAY):
        return _Array()
    if what == SCALAR:
        return _scalar(*given)
    if what == FROM_BUFFER:
        out = _Array()
        out.fill(*given)
        return out
    if what == DTYPE:
        return _Kind(given[0])
    if what == ENCODE and given[1] == "latin1":
        return given[0].encode("latin1")
    if what == NO_BYTES and given == ():
        return b""
    raise ValueError("it calls a name in a way that numpy does not")


def _asked(module: Any, attribute: Any, where: str) -> _Name:
    if not isinstance(module, str) or not isinstance(attribute, str):
        raise TypeError("it asks for a name that is no text")
    name = f"{module}.{attribute}"
    if name not in KNOWN:
        raise SourceError(
            f"{where}: it asks for {name[:100]!r}, and only numbers, texts, lists and numpy arrays are read, as"
            " anything else in a pickle could run code; save it again without that"
        )
    return _Name(KNOWN[name])


def _run(raw: bytes, where: str) -> Any:
    """What the instructions leave. Raises SourceError for what is refused, and LookupError, TypeError or ValueError for
    what is damaged."""
    stack: list[Any] = []
    below: list[list[Any]] = []
    memo: dict[int, Any] = {}
    found: Iterator[tuple[pickletools.OpcodeInfo, Any, Any]] = pickletools.genops(raw)
    for steps, (op, arg, at) in enumerate(found):
        if steps > MOST_STEPS:
            raise SourceError(f"{where}: it has over {MOST_STEPS} instructions; split it by camera or in time")
        if op.name in _VALUES:
            if isinstance(arg, int) and abs(arg) >= 10**MOST_DIGITS:
                raise ValueError(f"it holds a whole number of more than {MOST_DIGITS} digits")
            stack.append(arg)
        elif op.name in _MAKE:
            stack.append(_MAKE[op.name]())
        elif op.name in _LAST:
            count = _LAST[op.name]
            stack[len(stack) - count :] = [_of_last(stack, count)]
        elif op.name == "MARK":
            below.append(stack)
            stack = []
        elif op.name in _SINCE_MARK:
            since, stack = stack, below.pop()
            _SINCE_MARK[op.name](stack, since)
        elif op.name in ("APPEND", "SETITEM", "BUILD", "REDUCE", "STACK_GLOBAL"):
            _step(op.name, stack, where)
        elif op.name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
            memo[len(memo) if op.name == "MEMOIZE" else arg] = stack[-1]
        elif op.name in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(memo[arg])
        elif op.name == "GLOBAL":
            module, _, attribute = arg.partition(" ")
            stack.append(_asked(module, attribute, where))
        elif op.name == "POP":
            stack.pop()
        elif op.name == "DUP":
            stack.append(stack[-1])
        elif op.name == "STOP":
            return stack.pop()
        elif op.name not in ("PROTO", "FRAME"):
            asked = f"{op.name} {arg}".replace(" None", "")
            raise SourceError(
                f"{where}: byte {at} is the instruction {asked[:100]}, which makes more than numbers, texts, lists and"
                " numpy arrays and could run code; save it again without that"
            )
    raise ValueError("it has no end")


_NUMBERS = {"INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"}
_TEXTS = {"STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8"}
_VALUES = _NUMBERS | _TEXTS | {"BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"}
"""Instructions that hold a value."""
_MAKE: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_LIST": list,
    "EMPTY_DICT": dict,
    "EMPTY_TUPLE": tuple,
}
_LAST = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
"""Instructions that make a tuple of the last values."""


def _of_last(stack: list[Any], count: int) -> tuple[Any, ...]:
    if len(stack) < count:
        raise IndexError("it takes a value that is not there")
    return tuple(stack[len(stack) - count :])


def _extend(stack: list[Any], since: list[Any]) -> None:
    if not isinstance(stack[-1], list):
        raise TypeError("it appends to what is no list")
    stack[-1].extend(since)


def _set_items(stack: list[Any], since: list[Any]) -> None:
    if not isinstance(stack[-1], dict) or len(since) % 2:
        raise TypeError("it sets an item of what is no dictionary")
    for key, value in zip(since[::2], since[1::2], strict=True):
        if not isinstance(key, str | int):
            raise TypeError(f"it holds the key {shortened(type(key).__name__)}; texts and whole numbers are read")
        stack[-1][key] = value


def _dict(stack: list[Any], since: list[Any]) -> None:
    stack.append({})
    _set_items(stack, since)


_SINCE_MARK: dict[str, Callable[[list[Any], list[Any]], None]] = {
    "APPENDS": _extend,
    "SETITEMS": _set_items,
    "LIST": lambda stack, since: stack.append(since),
    "TUPLE": lambda stack, since: stack.append(tuple(since)),
    "DICT": _dict,
    "POP_MARK": lambda stack, since: None,
}
"""Instructions that take all values since the last mark."""


def _step(name: str, stack: list[Any], where: str) -> None:
    """Instructions that take what is on top."""
    top = stack.pop()
    if name == "APPEND":
        _extend(stack, [top])
    elif name == "SETITEM":
        _set_items(stack, [stack.pop(), top])
    elif name == "REDUCE":
        stack.append(_made(stack.pop(), top))
    elif name == "STACK_GLOBAL":
        stack.append(_asked(stack.pop(), top, where))
    elif isinstance(stack[-1], _Array | _Kind):
        stack[-1].build(top)
    else:
        raise TypeError("it sets the state of what has none")
