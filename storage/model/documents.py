"""Files of other people's, read within bounds: JSON, TOML, XML, tables and text; YAML is in `yaml_documents`.

Whoever opens a file that somebody else made goes through here. A file is a regular one, or it is not opened: a pipe
would be waited for, and /dev/zero never ends. Its size is looked at before it is read, its nesting, its number of
values and its whole numbers before anything is made of it. Every fault is a SourceError that says file, and line and
column where there are any.
"""

from __future__ import annotations

import csv
import json
import os
import re
import stat
import tomllib
import xml.etree.ElementTree as ElementTree
from codecs import BOM_UTF8
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from posegaussian.storage.model.errors import SourceError

MEGABYTE = 2**20
LARGEST_TEXT = 512 * MEGABYTE
"""Bytes of a table of joints or times: hours of many cameras."""
LARGEST_JSON = 256 * MEGABYTE
"""Bytes of a JSON file."""
LARGEST_SETTINGS = MEGABYTE
"""Bytes of a TOML or YAML file, calibrations included: a camera takes about 1000."""
LARGEST_XML = 16 * MEGABYTE
"""Bytes of an XML file."""
DEEPEST = 32
"""Levels of nesting."""
MOST_VALUES = 16_000_000
"""Values of a JSON file, where a list counts 2 and an object 8, as they take more memory: about 500 MB."""
MOST_PARTS = 32
"""Parts of a dotted key of TOML; each makes a table."""
MOST_DIGITS = 18
"""Digits of a whole number: what fits 64 bits."""


def regular(path: str | Path, what: str = "file", largest: int | None = None) -> os.stat_result:
    """What the system says of a regular file that can be read, of at most `largest` bytes; `what` is for the sentence.

    Raises SourceError for what is missing, a folder, a pipe, a device or too large.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError) as e:
        raise SourceError(f"cannot read {what} {path}: {getattr(e, 'strerror', None) or e}") from e
    if not stat.S_ISREG(found.st_mode):
        raise SourceError(
            f"cannot read {what} {path}: it is {_kind(found.st_mode)}, not a regular file; copy its content to one"
        )
    if largest is not None and found.st_size > largest:
        raise SourceError(
            f"cannot read {what} {path}: it has {found.st_size} bytes, at most {largest} are read; is it another file?"
        )
    return found


def _kind(mode: int) -> str:
    kinds = {
        "a folder": stat.S_ISDIR,
        "a pipe": stat.S_ISFIFO,
        "a device": lambda m: stat.S_ISCHR(m) or stat.S_ISBLK(m),
        "a socket": stat.S_ISSOCK,
    }
    return next((name for name, is_it in kinds.items() if is_it(mode)), "something special")


@contextmanager
def reader_of(path: str | Path, what: str = "file") -> Iterator[None]:
    """Turns what a library throws over a damaged file into a SourceError that names it;
    for the library's calls alone."""
    try:
        yield
    except (ArithmeticError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError) as e:
        said = (
            "it holds text that is not UTF-8"
            if isinstance(e, UnicodeDecodeError)
            else " ".join(str(e).split()) or type(e).__name__
        )
        raise SourceError(
            f"cannot read {what} {path}: {shortened(said, 300).strip(chr(39))}; it is damaged or cut off"
        ) from e


def read_bytes(path: str | Path, what: str = "file", largest: int | None = LARGEST_TEXT) -> bytes:
    """The content of a regular file of at most `largest` bytes. Raises SourceError."""
    regular(path, what, largest)
    try:
        return Path(path).read_bytes()
    except OSError as e:
        raise SourceError(f"cannot read {what} {path}: {e.strerror or e}") from e


def read_text(path: str | Path, what: str = "file", largest: int = LARGEST_TEXT) -> str:
    """The text of a file in UTF-8, line ends as \\n, without the byte order mark that editors of Windows begin it with.
    Raises SourceError, with the line of what is no UTF-8."""
    raw = read_bytes(path, what, largest).removeprefix(BOM_UTF8)
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as e:
        line = raw.count(b"\n", 0, e.start) + 1
        raise SourceError(
            f"cannot read {what} {path}: line {line} is not text in UTF-8 (byte {e.start}); save it as UTF-8"
        ) from e
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: str | Path, what: str = "file", largest: int = LARGEST_JSON) -> Any:
    """The content of a JSON file. Raises SourceError with path, line, column and cause."""
    return parse_json(read_text(path, what, largest), path)


def parse_json(text: str, where: str | Path) -> Any:
    """The content of a JSON text; `where` is for the sentence. Raises SourceError with line, column and cause."""
    weight = text.count(",") + 2 * text.count("[") + 8 * text.count("{")
    if weight > MOST_VALUES:
        raise SourceError(
            f"{where} holds about {weight} values; at most {MOST_VALUES} are read; split it by camera or in time"
        )
    try:
        found = json.loads(text, parse_int=whole)
    except json.JSONDecodeError as e:
        raise SourceError(f"{where}:{e.lineno}:{e.colno}: not valid JSON: {e.msg}") from e
    except ValueError as e:
        raise SourceError(f"{where}: not valid JSON: {e}") from e
    except RecursionError as e:
        raise SourceError(too_deep(where)) from e
    check_plain(found, where)
    return found


def too_deep(where: str | Path) -> str:
    """The sentence about a document that is nested too deeply."""
    return f"{where} is nested more than {DEEPEST} deep; no file of this kind is"


def check_plain(value: Any, where: str | Path) -> None:
    """Raise SourceError for plain values nested more than `DEEPEST` deep
    and whole numbers of over `MOST_DIGITS` digits."""
    level = [value]
    for _ in range(DEEPEST + 1):
        if huge := next((x for x in level if isinstance(x, int) and abs(x) >= 10**MOST_DIGITS), None):
            raise SourceError(
                f"{where} holds a whole number of about {huge.bit_length() * 3 // 10} digits; at most {MOST_DIGITS} "
                "are read"
            )
        level = [
            x
            for held in level
            if isinstance(held, dict | list)
            for x in (held.values() if isinstance(held, dict) else held)
        ]
        if not level:
            return
    raise SourceError(too_deep(where))


def whole(text: str) -> int:
    """A whole number of at most `MOST_DIGITS` digits. Raises ValueError."""
    if len(text.strip().lstrip("+-").lstrip("0")) > MOST_DIGITS:
        raise ValueError(
            f"whole number {text.strip()[:12]}... has {len(text.strip())} digits, at most {MOST_DIGITS} are read"
        )
    return int(text)


def shortened(value: Any, most: int = 60) -> str:
    """A value for a sentence, cut where it is long."""
    text = repr(value)
    return text if len(text) <= most else f"{text[:most]}..."


def read_toml(path: str | Path, what: str = "file") -> dict[str, Any]:
    """The content of a TOML file. Raises SourceError with path, cause and, where there is one, the line."""
    text = read_text(path, what, LARGEST_SETTINGS)
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > MOST_PARTS and max(part.count(".") for part in re.split(r"[=,\[\]{}]", line)) > MOST_PARTS:
            raise SourceError(f"{path}:{number}: a key has more than {MOST_PARTS} parts; no {what} has such a key")
    try:
        found = tomllib.loads(text)
    except ValueError as e:
        raise SourceError(f"{what} {path} cannot be read: {e}") from e
    except RecursionError as e:
        raise SourceError(too_deep(path)) from e
    check_plain(found, path)
    return found


class _NoDeclarations(ElementTree.TreeBuilder):
    """Refuses a DOCTYPE: entities declared in one can stand for gigabytes."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """What the parser calls for a document type declaration."""
        raise ValueError("it declares a document type, which is not read")


def read_xml(path: str | Path, what: str = "file") -> ElementTree.Element:
    """The root of an XML file without a document type. Raises SourceError with path and cause."""
    raw = read_bytes(path, what, LARGEST_XML)
    try:
        return ElementTree.fromstring(raw, ElementTree.XMLParser(target=_NoDeclarations()))
    except (ElementTree.ParseError, ValueError, LookupError) as e:
        raise SourceError(f"{what} {path} cannot be read: {e}") from e


def read_table(path: str | Path, what: str = "table") -> tuple[tuple[str, ...], Iterator[tuple[int, dict[str, str]]]]:
    """(column names, (line number, {column: text}) of every row) of a CSV file with a head.

    Raises SourceError, also while rows are taken.
    """
    lines = read_text(path, what).splitlines()
    reader = csv.DictReader(lines)
    try:
        names = tuple(reader.fieldnames or ())
    except csv.Error as e:
        raise SourceError(f"{path} line 1: {e}") from e
    return names, _rows(reader, path)


def _rows(reader: csv.DictReader[str], path: str | Path) -> Iterator[tuple[int, dict[str, str]]]:
    while True:
        try:
            row = next(reader, None)
        except csv.Error as e:
            raise SourceError(f"{path} line {reader.line_num}: {e}") from e
        if row is None:
            return
        yield reader.line_num, row
