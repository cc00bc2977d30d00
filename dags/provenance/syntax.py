"""What a source file does, as a digest of its syntax tree, and what it imports.

Trees take a second of every command that plans, so what was found of our own files is kept in the user's cache by what
they hold: a file of other content is another one, whatever its name and time.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import json
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import NotWritten
from posegaussian.storage.model.home import user_cache

PACKAGE = "posegaussian"
"""What our modules are imported from."""

Syntax = tuple[str, tuple[str, ...]]
"""(digest of the syntax tree without docstrings and without where our modules lie, dotted names it imports)."""

OWN = hashlib.blake2b(Path(__file__).read_bytes(), digest_size=8).hexdigest()
"""This module as it was when it was imported: another way to make digests has another memory."""

KEPT = 4096
"""Files that are remembered at most, those asked for last: some versions of this package."""


def syntax_of(content: bytes, file: str) -> Syntax:
    """The syntax of a file that holds `content`; its name is for the words of a SyntaxError alone."""
    tree = ast.parse(content, file)
    imports: list[str] = []
    for block in _blocks(tree):
        block[:] = [s for s in block if not _is_text(s)]
        for node in block:
            if isinstance(node, ast.Import):
                imports += [a.name for a in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                imports += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
                node.module = "" if node.module.partition(".")[0] == PACKAGE else node.module
    return hashlib.blake2b(ast.dump(tree).encode(), digest_size=16).hexdigest(), tuple(dict.fromkeys(imports))


class Remembered:
    """Syntax of files by what they hold, in one file of the user's cache."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.known = _read(file)
        self.news = False

    def of(self, content: bytes, file: str) -> Syntax:
        """As `syntax_of`, which is asked only about what nobody saw before."""
        key = hashlib.blake2b(content, digest_size=16).hexdigest()
        found = self.known.pop(key, None)
        self.news |= found is None
        self.known[key] = found or syntax_of(content, file)
        return self.known[key]

    def keep(self) -> None:
        """Write what is new. Where the folder takes nothing, the next process parses again."""
        if self.news and self.file.is_absolute():
            last = dict(list(self.known.items())[-KEPT:])
            with contextlib.suppress(NotWritten):
                write_atomically(self.file, json.dumps(last).encode())
        self.news = False


@lru_cache(maxsize=1)
def remembered() -> Remembered:
    """This user's, of this Python, whose trees differ from another's, and of this way to make digests."""
    return Remembered(user_cache() / "syntax" / f"{sys.version_info.major}.{sys.version_info.minor}-{OWN}.json")


def _read(file: Path) -> dict[str, Syntax]:
    """What a file of the cache holds; nothing where there is none, or none that can be read."""
    try:
        found = json.loads(file.read_bytes())
        return {key: (str(digest), tuple(map(str, imports))) for key, (digest, imports) in found.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


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
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )
