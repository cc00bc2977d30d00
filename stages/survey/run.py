"""Kernel of the survey stage: a background plate and its spread from a recorded sample of one view."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit

from stages.frames.display import to_display
from stages.io import Block, Inputs
from stages.survey.cover import people_cover
from stages.survey.params import SurveyParams

UNKNOWN = 255
"""Spread of a pixel whose background was never seen."""
FEWEST_SHOWN = 3
UNSTEADY = 12.0
"""Median spread of a whole picture, 1/255, above which camera or light are not static."""


def run(inputs: Inputs, params: SurveyParams) -> Iterator[Block]:
    """Yield sample [S] int64, plate [Y, X, 3] uint8 sRGB and spread [Y, X] uint8 of one view, in captured pixels.

    Y and X are the largest captured size of all views, padding is 0; S is `params.sample`, padding is -1. The sample lies
    evenly over the whole source of the view, first and last frame included, whatever range of frames is worked on.
    Plate: the median of each channel; spread: the median absolute deviation from it, largest of the three channels. Of
    an even number of frames the median is the lower middle value, so that it is one that occurred. Where joints are
    given, frames in which a person may cover a pixel do not count there (`cover.people_cover`).
    """
    view = inputs.view
    assert view is not None, "the survey stage runs over views"
    pictures = inputs.source("pictures")
    numbers = sample_numbers(pictures.numbers(view), params.sample)
    sample = np.full(params.sample, -1, dtype=np.int64)
    sample[: len(numbers)] = numbers
    yield Block("survey/sample", sample, view)

    width, height = pictures.size(view)
    stack = np.empty((len(numbers), height, width, 3), dtype=np.uint8)
    for i, picture in enumerate(pictures.read(view, [int(n) for n in numbers])):
        stack[i] = to_display(picture)
    covered = np.zeros(stack.shape[:3], dtype=np.uint8)
    if "joints2d" in inputs.facts and params.joints_margin > 0:
        joints = inputs.source("joints")
        for i, n in enumerate(numbers):
            covered[i] = people_cover(joints.read(view, int(n)), joints.joint_set, (width, height), params.joints_margin)
    plate, spread = median_and_spread(stack, covered)
    del stack, covered
    sizes = np.array([pictures.size(v) for v in range(len(inputs.views.names))])
    x, y = (int(n) for n in sizes.max(axis=0))
    yield Block("survey/plate", _padded(plate, (y, x, 3)), view)
    yield Block("survey/spread", _padded(spread, (y, x)), view)


def sample_numbers(numbers: np.ndarray, sample: int) -> np.ndarray:
    """[min(n, sample)] of the ascending source frame numbers, evenly, first and last included."""
    index = np.rint(np.linspace(0, len(numbers) - 1, min(len(numbers), sample))).astype(np.int64)
    return np.asarray(numbers, dtype=np.int64)[index]


def _padded(picture: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    out = np.zeros(shape, dtype=picture.dtype)
    out[: picture.shape[0], : picture.shape[1]] = picture
    return out


@njit(cache=True, nogil=True)
def _middle(counts: np.ndarray, rank: int) -> int:
    seen = 0
    for value in range(256):
        seen += counts[value]
        if seen > rank:
            return value
    return 255


@njit(cache=True, nogil=True)
def median_and_spread(stack: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower median [h, w, 3] and largest median absolute deviation of the channels [h, w], uint8, of [n, h, w, 3] uint8.

    Samples with `covered` [n, h, w] not 0 do not count; a pixel that fewer than three samples show uncovered takes the
    median of all and the spread 255 (`UNKNOWN`). Counting sort pixel by pixel: no second copy of the stack.
    """
    n, height, width, channels = stack.shape
    plate, spread = np.zeros((height, width, channels), dtype=np.uint8), np.zeros((height, width), dtype=np.uint8)
    counts, shown = np.zeros(256, dtype=np.int64), np.zeros(n, dtype=np.int64)
    for y in range(height):
        for x in range(width):
            m = 0
            for i in range(n):
                if covered[i, y, x] == 0:
                    shown[m] = i
                    m += 1
            unknown = m < min(FEWEST_SHOWN, n)
            if unknown:
                m = n
                for i in range(n):
                    shown[i] = i
            rank = (m - 1) // 2
            for c in range(channels):
                counts[:] = 0
                for i in shown[:m]:
                    counts[stack[i, y, x, c]] += 1
                middle = _middle(counts, rank)
                plate[y, x, c] = middle
                counts[:] = 0
                for i in shown[:m]:
                    counts[abs(np.int64(stack[i, y, x, c]) - middle)] += 1
                spread[y, x] = max(spread[y, x], _middle(counts, rank))
            if unknown:
                spread[y, x] = UNKNOWN
    return plate, spread


def check(block: Block, params: SurveyParams) -> list[str]:
    """Warnings about a sample too small for a plate and about pictures that are not static."""
    if block.array == "survey/sample":
        found = int((block.data >= 0).sum())
        return [f"view {block.view}: only {found} frames to take the background from; a plate wants 5 or more, or give masks"] if found < 5 else []
    known = block.data[(block.data > 0) & (block.data < UNKNOWN)] if block.array == "survey/spread" else np.zeros(0)
    if len(known):
        typical = float(np.median(known))
        if typical > UNSTEADY:
            return [f"view {block.view}: colours differ by {typical:.0f}/255 between frames all over the picture (bound {UNSTEADY:.0f}); the camera or the light is not static, do not use frames.matte: plate"]
    return []
