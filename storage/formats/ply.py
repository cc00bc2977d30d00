"""Binary PLY: the header as it stands, and elements of scalar properties as structured arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posegaussian.storage.model.documents import read_bytes
from posegaussian.storage.model.errors import SourceError

NAMES = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double")
SIZED = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
TYPES = dict(zip(NAMES, ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), strict=True)) | {
    n: np.dtype(n).str[1:] for n in SIZED
}
"""numpy types of PLY's two sets of names."""
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_HEADER = 2**20
"""Bytes in which a header must end; those of splats have about 2000."""


@dataclass(frozen=True, eq=False)
class Ply:
    """One file."""

    header: bytes
    """From `ply` to the line end after `end_header`, byte for byte."""
    elements: dict[str, np.ndarray]
    """{name: structured array}, in the order of the file."""

    def tobytes(self) -> bytes:
        """The file. Of a file that was read and not changed: its bytes."""
        return self.header + b"".join(e.tobytes() for e in self.elements.values())


def read_ply(path: str | Path) -> Ply:
    """Read a binary PLY of scalar properties.

    Raises SourceError, naming file and line or byte, for what is no PLY, for text, for lists, and for files that are
    shorter or longer than their header says.
    """
    raw = read_bytes(path, largest=None)
    header, types = _header(path, raw)
    elements, at = {}, len(header)
    for name, (count, dtype) in types.items():
        size = count * dtype.itemsize
        if at + size > len(raw):
            raise SourceError(
                f"{path}: the file ends at byte {len(raw)}, but element {name} of {count} rows of {dtype.itemsize}"
                f" bytes reaches from byte {at} to {at + size}; it was cut off, copy it again"
            )
        elements[name] = np.frombuffer(raw, dtype, count, at)
        at += size
    if at < len(raw):
        raise SourceError(
            f"{path}: {len(raw) - at} bytes are left after byte {at}, where the last element ends by the header; the"
            " header does not belong to this file"
        )
    return Ply(header, elements)


def _header(path: str | Path, raw: bytes) -> tuple[bytes, dict[str, tuple[int, np.dtype]]]:
    """The header's bytes, and {element: (rows, type of a row)}."""
    if raw[:4] not in (b"ply\n", b"ply\r"):
        raise SourceError(f"{path}: byte 0: a PLY file begins with the line 'ply', found {raw[:8]!r}")
    end = raw.find(b"\nend_header", 0, LONGEST_HEADER)
    stop = raw.find(b"\n", end + 1) + 1 if end >= 0 else 0
    if not stop:
        raise SourceError(
            f"{path}: no line 'end_header' in the first {min(len(raw), LONGEST_HEADER)} bytes;"
            " the file was cut off or is no PLY"
        )
    order, found = None, {}  # type: ignore[var-annotated]
    for number, line in enumerate(raw[:stop].decode("ascii", "replace").splitlines(), start=1):
        words = line.split()
        where = f"{path}: line {number} ({line.strip()!r})"
        if words[:1] == ["format"]:
            order = ORDERS.get(words[1] if len(words) > 1 else "")
            if order is None:
                raise SourceError(f"{where}: one of {', '.join(ORDERS)} is expected; save the file in binary")
        elif words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdecimal():
                raise SourceError(f"{where}: 'element NAME COUNT' is expected")
            found[words[1]] = (int(words[2]), [])
        elif words[:1] == ["property"]:
            if len(words) != 3 or words[1] not in TYPES or not found:
                raise SourceError(
                    f"{where}: 'property TYPE NAME' after an element is expected, with one of the types"
                    f" {', '.join(NAMES)}"
                )
            if words[2] in dict(found[next(reversed(found))][1]):
                raise SourceError(f"{where}: the element has a property {words[2]} already")
            found[next(reversed(found))][1].append((words[2], (order or "<") + TYPES[words[1]]))
        elif words and words[0] not in ("ply", "comment", "obj_info", "end_header"):
            raise SourceError(f"{where}: format, comment, element, property or end_header is expected")
    if order is None:
        raise SourceError(f"{path}: the header has no line 'format'; {' or '.join(ORDERS)} is expected")
    return raw[:stop], {name: (count, np.dtype(columns)) for name, (count, columns) in found.items()}
