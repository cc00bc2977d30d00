"""Which frames the survey looks at, and one pass over a view's pictures for all that look at them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from posegaussian.stages.contract.facts import MASKS
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.silhouettes.presence import shows_somebody, with_somebody
from posegaussian.stages.survey.algorithms.look import Look

FEWEST = 5
"""Frames below which a median is a matter of chance."""
COMPARED = 2
"""Sampled frames in which what views show is compared point by point."""


def sample_numbers(numbers: np.ndarray, sample: int) -> np.ndarray:
    """[min(n, sample)] of the ascending source frame numbers, evenly, first and last included."""
    index = np.rint(np.linspace(0, len(numbers) - 1, min(len(numbers), sample))).astype(np.int64)
    return np.asarray(numbers, dtype=np.int64)[index]


def compared_numbers(numbers: np.ndarray) -> np.ndarray:
    """[2] of the sampled source frames, away from the ends."""
    chosen = np.unique(np.rint(np.linspace(0, len(numbers) - 1, COMPARED + 2)[1:-1]).astype(int))
    return np.asarray(numbers)[chosen] if len(numbers) else np.zeros(0, np.int64)


def of_somebody(inputs: Inputs, numbers: np.ndarray) -> np.ndarray:
    """[m] of the sampled source frames [n] those that are compared: all, or some of those that show somebody, where in
    those that `compared_numbers` takes of all nobody is, by the masks that came with the capture."""
    if MASKS not in inputs.facts:
        return numbers
    pictures, masks, sources = inputs.source("pictures"), inputs.source("masks"), inputs.views.sources

    def seeing(number: int) -> int:
        having = [v for v in sources if number in pictures.numbers(v)]
        return sum(shows_somebody(mask) for v in having for mask in masks.read(v, [number]))

    return with_somebody(numbers, compared_numbers(numbers), seeing, len(sources))


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
