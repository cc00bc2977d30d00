"""Which frames the survey looks at, and one pass over a view's pictures for all that look at them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.survey.algorithms.look import Look

FEWEST = 5
"""Frames below which a median is a matter of chance."""


def sample_numbers(numbers: np.ndarray, sample: int) -> np.ndarray:
    """[min(n, sample)] of the ascending source frame numbers, evenly, first and last included."""
    index = np.rint(np.linspace(0, len(numbers) - 1, min(len(numbers), sample))).astype(np.int64)
    return np.asarray(numbers, dtype=np.int64)[index]


def worked_numbers(inputs: Inputs, view: int) -> np.ndarray:
    """[n] source frame numbers that are worked on and that a view has a picture of, ascending; around fewer than
    five, the nearest five it has."""
    worked, own = inputs.footage("pictures")[0], inputs.source("pictures").numbers(view)
    shared = np.intersect1d(worked, own)
    if len(shared) >= min(FEWEST, len(own)):
        return shared
    start = int(np.searchsorted(own, worked[0])) - max(0, FEWEST - len(worked)) // 2
    start = max(0, min(start, len(own) - FEWEST))
    return np.asarray(own[start : start + FEWEST])


def look(inputs: Inputs, view: int, looks: Sequence[Look]) -> Iterator[Block]:
    """Give every frame that any look asks for to all that do; each is decoded once."""
    asked = [set(map(int, seen.numbers)) for seen in looks]
    wanted = sorted(set().union(*asked))
    for number, picture in zip(wanted, inputs.source("pictures").read(view, wanted) if wanted else (), strict=True):
        shown = to_display(picture)
        for numbers, seen in zip(asked, looks, strict=True):
            if number in numbers:
                seen.see(number, picture, shown)
    for seen in looks:
        yield from seen.blocks()
