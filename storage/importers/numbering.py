"""Masks and joints by the numbers of their pictures, whatever the program that wrote them counted from."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TypeVar

import numpy as np

from posegaussian.storage.importers.common import ranges
from posegaussian.storage.model.capture import Stream
from posegaussian.storage.model.errors import SourceError

T = TypeVar("T")


def as_numbered(
    what: str, names: Sequence[str], found: Sequence[Mapping[int, T]], pictures: Sequence[Stream]
) -> tuple[list[Mapping[int, T]], list[str]]:
    """({source frame number: what was found} of every view, notes) of `what`, masks or joints, as they were numbered.

    Frames of a video have no number that somebody wrote, and most programs count what belongs to them from 1: where
    every camera has one a frame and all numbers are off alike, they go with frames one to one. Raises SourceError for
    the same beside pictures, in one camera, too: these have numbers as what belongs to them has, and every one would be
    a neighbour's.
    """
    off = _all_off(found, pictures)
    if off and all(s.kind != "images" for s in pictures):
        first = pictures[0].numbers[0]
        said = (
            f"{what}: one a frame in every camera, numbered from {first + off} where frames are from {first}; they are"
            " taken one to one, the first for the first frame"
        )
        return [{n - off: f for n, f in own.items()} for own in found], [said]
    for name, own, stream in zip(names, found, pictures, strict=True):
        by = off or (_all_off([own], [stream]) if stream.kind == "images" else 0)
        if by and own.keys() & set(stream.numbers):
            where = "in every camera" if off else "throughout"
            raise SourceError(
                f"camera {name}: {told(what, own, stream.numbers)}: as many, and {abs(by)} off {where}; number"
                f" {what} as their pictures are, so that each has its picture's number"
            )
    return list(found), []


def told(what: str, own: Collection[int], pictures: Collection[int]) -> str:
    """Which frames `what` is of, and which the pictures beside it."""
    of, beside = (ranges(np.array(sorted(numbers))) for numbers in (own, pictures))
    return f"its {what} are frames {of}, its pictures {beside}"


def _all_off(found: Sequence[Mapping[int, T]], pictures: Sequence[Stream]) -> int:
    """By how much all numbers are larger than those of the pictures, one a picture in every camera that has any; 0
    where there is no such number."""
    pairs = [(sorted(own), s.numbers) for own, s in zip(found, pictures, strict=True) if own]
    if any(len(own) != len(numbers) for own, numbers in pairs):
        return 0
    off = {a - b for own, numbers in pairs for a, b in zip(own, numbers, strict=True)}
    return off.pop() if len(off) == 1 else 0
