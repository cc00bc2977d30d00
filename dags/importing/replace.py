"""Importing under a name that is taken: the same capture is updated, another one replaces it only when that is said."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.variants import others
from posegaussian.dags.runtime.run_registry import refuse_busy
from posegaussian.storage.archive import set_aside
from posegaussian.storage.archive.deletion import delete_folder
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.model.capture import Capture, SourceFile
from posegaussian.storage.model.errors import ArchiveError, BrokenRecord


def there(archive: Archive, name: str) -> SequenceGroup | None:
    """The sequence of a name; None for a new one, and for one whose record is broken and is replaced now.

    Raises ArchiveError for a sequence of a newer format.
    """
    if name not in archive.names():
        return None
    try:
        found = archive.sequence(name)
        _ = found.capture
    except BrokenRecord:
        return None
    return found


def same(capture: Capture) -> Callable[[Capture], bool]:
    """Whether an older capture is this one: a picture file in common, or, for files that were moved or copied, the
    content of half of them.

    Other cameras, another calibration, more frames and files written anew in their place make no other capture.
    """
    paths, contents = {f.path for f in _pictures(capture)}, {f.sha256 for f in _pictures(capture)}

    def is_it(old: Capture) -> bool:
        theirs = {f.sha256 for f in _pictures(old)}
        return any(f.path in paths for f in _pictures(old)) or 2 * len(contents & theirs) > min(
            len(contents), len(theirs)
        )

    return is_it


def filmed_into(folder: Path) -> Callable[[Capture], bool]:
    """Whether an older capture's pictures lie in a folder, which a simulation is about to write."""
    inside = folder.resolve()
    return lambda old: all(Path(f.path).is_relative_to(inside) for f in _pictures(old))


def make_room(
    archive: Archive, name: str, is_same: Callable[[Capture], bool], what: str, replace: bool
) -> tuple[SequenceGroup | None, list[str]]:
    """The sequence that the import updates, or None where it makes a new one, and sentences; another capture under that
    name is removed, if told so, with its variants and what is put aside of it.

    Raises ArchiveError for another capture without `replace`, LeaseHeld while a run works on what would be removed.
    """
    old = there(archive, name)
    if old is None or is_same(old.capture):
        return old, []
    if not replace:
        raise ArchiveError(
            f"sequence {name} is there already: {_told(old)}; {what} is another capture, with no picture in common:"
            " give it a name of its own with --sequence, or put it in the other's place with --replace, which deletes"
            f" {_results(old)}"
        )
    everywhere = others(old)
    for sequence in everywhere:
        refuse_busy(sequence, "import --replace")
    said = [f"replaced: {_told(old)}; deleted: {_results(old)}"]
    for sequence in everywhere:
        set_aside.clear_sequence(Archive(sequence.root.parent), name)
    for beside in everywhere[1:]:
        delete_folder(beside.root)
    # Receipts first: whatever is left when this is interrupted counts as not made.
    for child in sorted(old.root.iterdir(), key=lambda p: p != old.receipts):
        if child.is_dir() and not child.is_symlink():
            shutil.rmtree(child)
        elif child.name != "zarr.json":
            child.unlink()
    return None, said


def _pictures(capture: Capture) -> list[SourceFile]:
    return [f for s in capture.pictures for f in s.files]


def _told(sequence: SequenceGroup) -> str:
    """What is registered, and where it came from."""
    c = sequence.capture
    folder = os.path.commonpath([str(Path(f.path).parent) for f in _pictures(c)])
    return (
        f"layout {c.layout}, {number(len(c.rig), 'camera')}"
        f" ({', '.join(c.rig.names[:4])}{', ...' if len(c.rig) > 4 else ''}), {number(len(c.numbers), 'frame')}"
        f" ({c.numbers[0]}..{c.numbers[-1]}), pictures in {folder}"
    )


def _results(sequence: SequenceGroup) -> str:
    made = sum(1 for _ in scan_receipts(sequence))
    return (
        f"all that was computed from it ({number(made, 'result')})"
        if made
        else "nothing, as nothing was computed from it yet"
    )
