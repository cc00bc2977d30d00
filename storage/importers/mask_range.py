"""From which values masks run to which: those of a video's range and those with a veil hold neither 0 nor 255."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from posegaussian.storage.model.masks import FOREGROUND

_OUTLINE = 0.02
"""Share of a mask's longer side around outlines that is not looked at: hair and motion are soft there."""
_FEWEST = 64
"""Pixels of subject and of background, at least, by which a camera's masks are judged."""
_BLACK, _WHITE = 4, 250
"""Nine tenths of a background hold as much at least, of a subject as much at most, where masks run otherwise."""
_NOISE = 1.25
"""How far evenly spread noise reaches from its middle, in distances from there to nine tenths of it."""
_NARROWEST = 64
"""Values between both, at least: what holds less is no matte."""

Range = tuple[int, int]
"""The values that mean 0 and 255."""
RIGHT: Range = (0, 255)


def value_range(masks: Sequence[np.ndarray]) -> Range | None:
    """What the background and the subject of a camera's masks [h, w] uint8 hold; `RIGHT` where that is as it should be,
    None where one of both is not seen.

    Nine tenths of the background hold 4 or more where there is a floor, and never by the rings of a JPEG or by hair;
    nine tenths of the subject 250 or less where there is a ceiling. Noise reaches as far beyond the middle on the side
    where outlines and hair are as on the other, where it is alone.
    """
    import cv2

    dark, light = np.zeros(256, np.int64), np.zeros(256, np.int64)
    for mask in masks:
        reach = 2 * max(2, round(_OUTLINE * max(mask.shape))) + 1
        around = np.ones((reach, reach), np.uint8)
        inside = (mask > FOREGROUND).astype(np.uint8)
        dark += np.bincount(mask[cv2.dilate(inside, around) == 0], minlength=256)
        light += np.bincount(mask[cv2.erode(inside, around) > 0], minlength=256)
    if min(dark.sum(), light.sum()) < _FEWEST:
        return None
    (low, floor), (ceiling, high) = _at(dark, 0.1, 0.5), _at(light, 0.5, 0.9)
    black = round(floor + _NOISE * (floor - low)) if low >= _BLACK else 0
    white = round(ceiling - _NOISE * (high - ceiling)) if high <= _WHITE else 255
    return (black, white) if white - black >= _NARROWEST else RIGHT


def ranges_of(seen: Mapping[str, Range | None]) -> dict[str, Range]:
    """The range of every camera's masks, of what was seen of it: one whose subject is not seen has the others', in the
    middle."""
    known = np.sort([r for r in seen.values() if r is not None] or [RIGHT], axis=0)
    black, white = known[(len(known) - 1) // 2]
    return {n: (int(black), int(white)) if r is None else r for n, r in seen.items()}


def range_notes(ranges: Mapping[str, Range]) -> list[str]:
    """The sentence on cameras whose masks do not run from 0 to 255."""
    other = {n: r for n, r in ranges.items() if r != RIGHT}
    if not other:
        return []
    whose = "" if len(other) == len(ranges) else f" of {', '.join(other)}"
    black, white = ([min(ends), max(ends)] for ends in zip(*other.values(), strict=True))
    held = [f"{least}" if least == most else f"{least} to {most}" for least, most in (black, white)]
    note = (
        f"masks{whose} hold up to {held[0]} where nobody is and {held[1]} or more on the subject, as those of a video's"
        " range or under a grey veil do; they are spread to 0 and 255"
    )
    return [note]


def _at(counts: np.ndarray, *shares: float) -> list[int]:
    """The values below which these shares lie, of how often each of 256 occurs."""
    return [int(v) for v in np.searchsorted(np.cumsum(counts), np.array(shares) * counts.sum())]
