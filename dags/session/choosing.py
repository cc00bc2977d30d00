"""Which sequences of an archive a command is about: by name, or by a glob."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence

from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ArchiveError


def chosen(archive: Archive, globs: Sequence[str]) -> list[str]:
    """Names of the sequences that any glob matches; all without globs. What is a sequence's name means that one alone,
    though it may be read as a glob: a name may hold brackets.

    Raises ArchiveError when a glob matches none, and for an archive without a sequence.
    """
    known = archive.names()
    if not known:
        raise ArchiveError(
            f"archive {archive.root} has no sequence yet; `posegaussian import auto FOLDER` registers a"
            " capture, `posegaussian simulate plain` films a simulated person; `--archive URL` names another"
        )
    meant: set[str] = set()
    for g in globs:
        found = [g] if g in known else fnmatch.filter(known, g)
        if not found:
            raise ArchiveError(f"no sequence matches {g!r}; archive {archive.root} has {', '.join(known)}")
        meant.update(found)
    return [n for n in known if not globs or n in meant]


def chosen_one(archive: Archive, glob: str | None) -> str:
    """The one sequence that a name or glob chooses. Raises ArchiveError for none, for several, and without a glob."""
    if glob is None:
        raise ArchiveError(
            f"no sequence is named; archive {archive.root} has {', '.join(chosen(archive, []))}: name one"
        )
    matches = chosen(archive, [glob])
    if len(matches) > 1:
        raise ArchiveError(f"{glob!r} matches {len(matches)} sequences, {', '.join(matches)}; name one")
    return matches[0]
