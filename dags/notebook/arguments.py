"""What a notebook's arguments mean: one camera of several, one word where several may stand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posegaussian.storage.model.errors import ArchiveError


def camera_index(names: Sequence[str], view: str | int, owner: str) -> int:
    """The place of a camera that is given by name or index; negative ones count from the end, as Python's do.

    Raises ArchiveError, which names the cameras that the owner has, for any other.
    """
    if isinstance(view, str) and view in names:
        return names.index(view)
    if isinstance(view, int | np.integer) and -len(names) <= view < len(names):
        return int(view) % len(names)
    raise ArchiveError(
        f"{owner} has no camera {view!r}; it has {', '.join(names)}: give one of these names, or an index within"
        f" 0..{len(names) - 1}"
    )


def listed(words: Sequence[str]) -> tuple[str, ...]:
    """Words as a tuple; a single one is a list of one, not of its letters."""
    return (words,) if isinstance(words, str) else tuple(words)
