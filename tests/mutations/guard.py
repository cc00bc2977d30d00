"""A line of the code that a hard case stands guard over, and what is put in its place."""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Edit:
    """One text of one file, and another in its place."""

    file: str
    """Below the repository: stages/geometry/pairs.py."""
    line: str
    """Stands in the file exactly once."""
    broken: str
    """As somebody would have written it who had not met the case."""

    @property
    def module(self) -> str:
        """The name it is imported by."""
        return "posegaussian." + self.file.removesuffix(".py").replace("/", ".")


@dataclass(frozen=True)
class Guard:
    """What is broken at once: one line, or lines that keep the same thing out one behind the other."""

    case: str
    """S1."""
    edits: tuple[Edit, ...]

    @property
    def name(self) -> str:
        """Of the first line, as the table shows it."""
        return f"{self.edits[0].file}: {self.edits[0].line.strip().splitlines()[0]}"

    def sources(self) -> dict[str, str]:
        """{module: its source, broken}. Raises ValueError where a line does not stand in its file exactly once, or what
        stands in its place is no Python."""
        found: dict[str, str] = {}
        for edit in self.edits:
            text = found.get(edit.module) or (ROOT / edit.file).read_text(encoding="utf-8")
            if (count := text.count(edit.line)) != 1:
                raise ValueError(
                    f"{self.case} guards a line that stands in {edit.file} {count} times: {edit.line!r}; name the line"
                    " that does its work now"
                )
            found[edit.module] = text.replace(edit.line, edit.broken)
            ast.parse(found[edit.module])
        return found

    @property
    def compiled(self) -> bool:
        """Whether numba compiles anything of what is broken."""
        return any("@compiled" in source for source in self.sources().values())


def guards_of(case: str) -> Callable[..., Guard]:
    """A guard of a case: (file, line, what stands there instead), and `also` what has to fall with it."""

    def guard(file: str, line: str, broken: str, *also: tuple[str, str, str]) -> Guard:
        return Guard(case, (Edit(file, line, broken), *(Edit(*more) for more in also)))

    return guard
