"""Which layout a folder has, by the files in it and what they hold,
and the sentences for one that was named wrongly."""

from __future__ import annotations

import shlex
from pathlib import Path

from posegaussian.storage.importers.closest import held, lacking, unrecognised
from posegaussian.storage.importers.common import folder, subfolders
from posegaussian.storage.importers.registry import IMPORTERS
from posegaussian.storage.model.errors import SourceError


def fitting(base: Path) -> list[str]:
    """Layouts that a folder has everything of; a general one only by itself."""
    found = [n for n, i in IMPORTERS.items() if base.is_dir() and all(t.found(base) for t in i.traits)]
    return [n for n in found if not IMPORTERS[n].general] or found


def recognised(base: Path) -> str:
    """The one layout of a folder. Raises SourceError where none fits, with what the closest ones lack, where several
    do, and for a folder of captures."""
    found = fitting(folder(base))
    inside = {p.name: fits for p in subfolders(base) if (fits := fitting(p))}
    if len(inside) > 1 and not {n for fits in inside.values() for n in fits} <= {*found}:
        told = ", ".join(f"{name} ({' or '.join(fits)})" for name, fits in inside.items())
        raise SourceError(f"{base} holds several captures, {told}; give the folder of one of them")
    if len(found) > 1:
        raise SourceError(f"{base} fits the layouts {' and '.join(found)}; name the one that is meant in place of auto")
    if not found and inside:
        ((name, fits),) = inside.items()
        raise SourceError(
            f"{base} is no capture, its folder {name} is one ({' or '.join(fits)}):"
            f" posegaussian import auto {shlex.quote(str(base / name))}"
        )
    if not found:
        raise SourceError("\n".join(unrecognised(base)))
    return found[0]


def explained(layout: str, base: Path) -> str:
    """What a layout expects that a folder lacks, what is there instead, and the layout that fits;
    empty where it lacks nothing."""
    lacks = lacking(base, layout) if base.is_dir() else []
    if not lacks:
        return ""
    other = [n for n in fitting(base) if n != layout]
    fits = (
        f"that is the layout {' or '.join(other)}: posegaussian import {other[0]} {shlex.quote(str(base))}"
        if other
        else "no other layout fits it either"
    )
    expected = [t.expected for t in IMPORTERS[layout].traits]
    missing = "nothing of this" if len(lacks) == len(expected) else f"no {'; no '.join(t.expected for t in lacks)}"
    return f"the layout {layout} expects {'; '.join(expected)}: {base} has {missing}. It holds {held(base)}; {fits}"
