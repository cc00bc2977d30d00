"""Which layout a folder has, by the files in it and what they hold,
and the sentences for one that was named wrongly."""

from __future__ import annotations

import shlex
from pathlib import Path

from posegaussian.storage.importers.common import folder, natural
from posegaussian.storage.importers.registry import IMPORTERS
from posegaussian.storage.model.errors import SourceError

SHOWN = 6
"""Entries of a folder that a sentence names."""


def fitting(base: Path) -> list[str]:
    """Layouts that a folder has everything of; a general one only by itself."""
    found = [n for n, i in IMPORTERS.items() if base.is_dir() and all(t.found(base) for t in i.traits)]
    return [n for n in found if not IMPORTERS[n].general] or found


def recognised(base: Path) -> str:
    """The one layout of a folder. Raises SourceError, with what each layout lacks, where none fits or several do, and
    for a folder of captures."""
    found = fitting(folder(base))
    inside = {p.name: fits for p in sorted(base.iterdir()) if p.is_dir() and (fits := fitting(p))}
    if len(inside) > 1 and not {n for fits in inside.values() for n in fits} <= {*found}:
        told = ", ".join(f"{name} ({' or '.join(fits)})" for name, fits in inside.items())
        raise SourceError(f"{base} holds several captures, {told}; give the folder of one of them")
    if len(found) > 1:
        raise SourceError(f"{base} fits the layouts {' and '.join(found)}; name the one that is meant in place of auto")
    if not found:
        raise SourceError(
            "\n".join(
                [
                    f"{base} has no layout that is read; it holds {held(base)}",
                    *(f"for the layout {name} it lacks {'; '.join(_lacking(base, name))}" for name in IMPORTERS),
                ]
            )
        )
    return found[0]


def explained(layout: str, base: Path) -> str:
    """What a layout expects that a folder lacks, what is there instead, and the layout that fits;
    empty where it lacks nothing."""
    lacking = _lacking(base, layout) if base.is_dir() else []
    if not lacking:
        return ""
    other = [n for n in fitting(base) if n != layout]
    fits = (
        f"that is the layout {' or '.join(other)}: posegaussian import {other[0]} {shlex.quote(str(base))}"
        if other
        else "no other layout fits it either"
    )
    expected = [t.expected for t in IMPORTERS[layout].traits]
    missing = "nothing of this" if len(lacking) == len(expected) else f"no {'; no '.join(lacking)}"
    return f"the layout {layout} expects {'; '.join(expected)}: {base} has {missing}. It holds {held(base)}; {fits}"


def held(base: Path) -> str:
    """What a folder holds, for a sentence."""
    entries = sorted(base.iterdir(), key=lambda p: (p.is_file(), natural(p.name)))
    named = [p.name + ("/" if p.is_dir() else "") for p in entries[:SHOWN]]
    return ", ".join(named) + (f" and {len(entries) - SHOWN} more" if len(entries) > SHOWN else "")


def _lacking(base: Path, layout: str) -> list[str]:
    return [t.expected for t in IMPORTERS[layout].traits if not t.found(base)]
