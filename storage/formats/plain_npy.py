"""Arrays of numbers in .npy files, without anything that could run: no objects, and no more bytes than the file has.

Format: numpy.lib.format, versions 1 to 3. numpy's own reader parses the header as Python, and makes an array of its
shape before it looks how many bytes there are.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from posegaussian.storage.model.documents import MEGABYTE, read_bytes, shortened, whole
from posegaussian.storage.model.errors import SourceError

MAGIC = b"\x93NUMPY"
LENGTHS = {1: 2, 2: 4, 3: 4}
"""Bytes of the header's length, by version."""
HEADER = re.compile(
    r"\{'descr': '(?P<kind>[<>|=][a-zA-Z]\d*)', 'fortran_order': (?P<columns>True|False),"
    r" 'shape': \((?P<shape>[\d, ]*)\),? *\}\s*"
)
MOST_AXES = 8
"""Axes of an array."""


def read_numbers(path: str | Path, what: str, largest: int = 16 * MEGABYTE) -> np.ndarray:
    """The array of a file of at most `largest` bytes as float64.

    Raises SourceError, naming the file, for objects, texts and complex numbers, and for a file that is shorter or
    longer than its header says.
    """
    raw = read_bytes(path, what, largest)
    found, start = header(raw, f"{what} {path}")
    kind, shape = found["kind"], found["shape"]
    if kind[1] not in "fiu":
        raise SourceError(
            f"cannot read {what} {path}: it holds {kind}, numbers are expected; arrays of objects are pickles, which"
            " could run code, so save it as an array of float64"
        )
    try:
        dtype, axes = np.dtype(kind), tuple(whole(n) for n in shape.replace(" ", "").split(",") if n)
    except (TypeError, ValueError) as e:
        raise SourceError(f"cannot read {what} {path}: {kind} ({shape}) is no array of numbers: {e}") from e
    count = 1
    for n in axes:
        count *= n
    if len(axes) > MOST_AXES or count * dtype.itemsize != len(raw) - start:
        raise SourceError(
            f"cannot read {what} {path}: its header says ({shape}) of {kind}, {len(raw) - start} bytes follow; it is"
            " damaged or cut off"
        )
    order = "F" if found["columns"] == "True" else "C"
    return np.frombuffer(raw, dtype, count, start).reshape(axes, order=order).astype(np.float64)  # type: ignore[call-overload]


def header(raw: bytes, where: str) -> tuple[re.Match[str], int]:
    """(the parts of a .npy file's header, where what it describes begins); `where` is for the sentence. Raises
    SourceError."""
    size = LENGTHS.get(raw[6], 0) if raw.startswith(MAGIC) and len(raw) > 12 else 0
    if not size:
        raise SourceError(f"cannot read {where}: it does not begin as a .npy file of version 1 to 3")
    start = 8 + size + int.from_bytes(raw[8 : 8 + size], "little")
    text = raw[8 + size : min(start, 8 + size + 1000)].decode("latin1")
    if start > len(raw) or (found := HEADER.fullmatch(text)) is None:
        raise SourceError(f"cannot read {where}: its header {shortened(text)} is not that of an array of numbers")
    return found, start
