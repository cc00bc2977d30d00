"""What pydantic finds wrong with settings, as sentences for whoever wrote them."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from posegaussian.dags.config.yaml_source import Location


def faults_of(
    error: ValidationError, values: Mapping[str, Any], unknown: Callable[[Location], str]
) -> list[tuple[Location, str]]:
    """(place, what is wrong) of every fault of a validation.

    Args:
        error: what pydantic raised.
        values: what it was given; places are those of its keys and items.
        unknown: what is to be said about a key that the model does not have; see `unknown_key`.
    """
    out: dict[tuple[Location, str], None] = {}
    faults = error.errors()
    for fault in faults:
        location = _in_file(values, fault["loc"])
        if fault["type"] == "extra_forbidden":
            said = unknown(location)
        elif fault["type"] == "missing" and isinstance(fault["loc"][-1], int):
            said = _too_few(fault, faults)
        else:
            said = _sentence(fault)
        out[location, said] = None
    return list(out)


def unknown_key(name: str, known: Iterable[str], elsewhere: Sequence[str] = (), thing: str = "unknown key") -> str:
    """The sentence about a key that is not known: the nearest of the known ones, or all; before them, those
    `elsewhere`."""
    known = list(known)
    close = elsewhere or difflib.get_close_matches(name, known, n=1)
    if close:
        return f'{thing}; did you mean "{close[0]}"?'
    return f"{thing}; known are {', '.join(known)}" if known else thing


def present(node: Any, location: Location) -> bool:
    """Whether values hold something at a place."""
    for part in location:
        if not _has(node, part):
            return False
        node = node[part]
    return True


def dotted(location: Location) -> str:
    """A place as it is written on the command line, `depth.method`."""
    return ".".join(map(str, location))


def _has(node: Any, part: str | int) -> bool:
    if isinstance(node, Mapping):
        return part in node
    return isinstance(node, list) and isinstance(part, int) and part < len(node)


def _in_file(values: Any, location: Location) -> Location:
    """The place as the file has it: without the tags that pydantic adds for a key, or for one of several models."""
    out: list[str | int] = []
    node = values
    for n, part in enumerate(location):
        if _has(node, part):
            out.append(part)
            node = node[part]
        elif n == len(location) - 1 and isinstance(node, Mapping) and part != "[key]":
            out.append(part)  # what is missing
    return tuple(out)


def _too_few(fault: Mapping[str, Any], faults: Sequence[Mapping[str, Any]]) -> str:
    """How many values a list is to have: pydantic names each of those that are not there."""
    lacking = [f["loc"][-1] for f in faults if f["type"] == "missing" and f["loc"][:-1] == fault["loc"][:-1]]
    given = len(fault["input"])
    return f"{max(lacking) + 1} values are needed, {given} {'is' if given == 1 else 'are'} given"


def _sentence(fault: Mapping[str, Any]) -> str:
    message = fault["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    return message if fault["type"] in ("value_error", "missing") else f"{message}, got {fault['input']!r}"
