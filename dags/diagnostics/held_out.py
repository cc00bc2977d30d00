"""What is said about cameras that are held out though no setting says so."""

from __future__ import annotations

from collections.abc import Iterable

from posegaussian.dags.planning.context import Context


def told(contexts: Iterable[Context]) -> list[str]:
    """A line for every set of cameras that captures hold out by themselves, with the sequences it is of."""
    alike: dict[str, list[str]] = {}
    for c in contexts:
        if c.settings.views.held_out is None and c.held_out:
            alike.setdefault(", ".join(c.held_out), []).append(c.sequence.name)
    return [
        f"held out as imported: {cameras} (of {names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''});"
        " views.held_out overrules it"
        for cameras, names in alike.items()
    ]
