"""What an importer declares: the command, its help and the recognition of folders follow from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from posegaussian.storage.importers.common import ImportOptions
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError


class Trait(NamedTuple):
    """What a layout cannot do without."""

    expected: str
    """As a sentence names it."""
    found: Callable[[Path], bool]
    """Whether a folder has it."""
    filmed: bool = False
    """Whether it is the pictures, videos or masks; else it is what places their cameras."""


@dataclass(frozen=True)
class Importer:
    """One layout that captures come in."""

    name: str
    """As in `import NAME SOURCE`."""
    summary: str
    """One sentence for the help."""
    options: type[ImportOptions]
    """What the user may choose."""
    find: Callable[[Path, Any], Capture]
    """`find(source, options)`; raises a UserError."""
    traits: tuple[Trait, ...]
    """By which a folder is recognised."""
    by_definition: bool = False
    """Whether the layout defines its poses as metres and world to camera; else its importer says what it found."""
    masked: bool = False
    """Whether it reads `masks/CAM/000000.png`."""
    timed: bool = False
    """Whether it numbers frames by times of its own, and not in the order of the videos."""
    general: bool = False
    """Whether it counts only where no other layout fits: it reads what more particular ones have, too."""


def or_broken(look: Callable[[], object]) -> bool:
    """Whether something is there; a file that cannot be read counts: what is wrong with it is said when it is read for
    good."""
    try:
        return bool(look())
    except UserError:
        return True
