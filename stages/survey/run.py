"""Kernel of the survey stage: background plate, colours and motion of one view, from a recorded sample of its frames."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit

from stages.detection.reader import EstimatedJoints, joint_reader
from stages.frames.display import to_display
from stages.io import Block, Inputs
from stages.survey.cover import people_cover
from stages.survey.joints import fit_of_view, joints_in_space, runs_of_joints
from stages.survey.light import light_of_view
from stages.survey.motion import jitter_and_motion, run_starts
from stages.survey.noise import noise_of_view
from stages.survey.outlines import outline_of_view
from stages.survey.params import COLORS, JOINT_FIT, LIGHT, MOTION, NOISE, OUTLINES, PLATE, SILHOUETTES, SPREAD, SURFACE, SurveyParams
from stages.survey.patches import PATCHES, patch_colors, typical_colors
from stages.survey.silhouettes import agreement_of_view
from stages.survey.surface import surface_stops

UNKNOWN = 255
"""Spread of a pixel whose background was never seen."""
FEWER = 3
"""One in so many of the sampled frames begins a run in which estimated joints' motion is measured: looking costs."""
FEWEST_SHOWN = 3
UNSTEADY = 12.0
"""Median spread of a whole picture, 1/255, above which camera or light are not static."""


def run(inputs: Inputs, params: SurveyParams) -> Iterator[Block]:
    """Yield sample [S] int64 of one view and, as far as they are asked for, its plate, spread, colors and motion.

    What is asked for stands in `inputs.facts`. The sample lies evenly over the whole source of the view, first and last
    frame included, whatever range of frames is worked on; S is `params.sample`, padding is -1. Pictures are decoded only
    where they are looked at. Colours and motion of a view that is no source are 0: nothing follows from it.
    """
    view = inputs.view
    assert view is not None, "the survey stage runs over views"
    numbers = inputs.source("pictures").numbers(view)
    chosen = sample_numbers(numbers, params.sample)
    sample = np.full(params.sample, -1, dtype=np.int64)
    sample[: len(chosen)] = chosen
    yield Block("survey/sample", sample, view)
    runs = run_starts(numbers, chosen if "detected" not in inputs.facts else chosen[::FEWER])
    if "detected" in inputs.facts:
        _look_ahead(inputs, view, chosen, runs)
    plate, colors = bool(inputs.facts & {PLATE, SPREAD}), COLORS in inputs.facts
    if plate or colors:
        yield from _of_pictures(inputs, params, view, chosen, plate, colors)
    if SURFACE in inputs.facts:
        yield Block(SURFACE, surface_stops(inputs, view, chosen), view)
    if MOTION in inputs.facts:
        found = jitter_and_motion(runs_of_joints(inputs, view, runs)) if view in inputs.views.sources else (0.0, 0.0, 0)
        yield Block(MOTION, np.array(found, dtype=np.float64), view)
    if SILHOUETTES in inputs.facts:
        yield Block(SILHOUETTES, np.array([agreement_of_view(inputs, view, chosen)]), view)
    if OUTLINES in inputs.facts:
        yield Block(OUTLINES, outline_of_view(inputs, view, chosen), view)
    if JOINT_FIT in inputs.facts:
        yield Block(JOINT_FIT, fit_of_view(inputs, view, chosen), view)
    if LIGHT in inputs.facts:
        yield Block(LIGHT, light_of_view(inputs, view, chosen), view)
    if NOISE in inputs.facts:
        yield Block(NOISE, np.array([noise_of_view(inputs, view, chosen)]), view)


def _look_ahead(inputs: Inputs, view: int, chosen: np.ndarray, runs: list[np.ndarray]) -> None:
    """Have joints estimated in one pass over each view's pictures, instead of picture by picture."""
    estimated, sources = joint_reader(inputs), inputs.views.sources
    assert isinstance(estimated, EstimatedJoints)
    own = [*(chosen if inputs.facts & {PLATE, SPREAD} else ()), *(n for run in runs for n in run if MOTION in inputs.facts)]
    if view in sources:
        estimated.look_at(view, own)
    for v in sources if inputs.facts & {COLORS, JOINT_FIT} else ():
        estimated.look_at(v, chosen)


def _of_pictures(inputs: Inputs, params: SurveyParams, view: int, numbers: np.ndarray, plate: bool, colors: bool) -> Iterator[Block]:
    """What follows from the sampled pictures [n] of one view.

    survey/plate [Y, X, 3] uint8 sRGB and survey/spread [Y, X] uint8 in captured pixels; Y and X are the largest captured
    size of all views, padding is 0. Plate: the median of each channel; spread: the median absolute deviation from it,
    largest of the three channels. Of an even number of frames the median is the lower middle value, so that it is one that
    occurred. Where joints are given, frames in which a person may cover a pixel do not count there (`cover.people_cover`).
    survey/colors [192, 3] float32: `patches.typical_colors`.
    """
    pictures = inputs.source("pictures")
    width, height = pictures.size(view)
    joints = joint_reader(inputs) if "joints2d" in inputs.facts and params.joints_margin > 0 else None
    seen = colors and view in inputs.views.sources and bool(inputs.facts & {"joints2d", "joints3d"})
    stack = np.empty((len(numbers) if plate else 0, height, width, 3), dtype=np.uint8)
    covered = np.zeros(stack.shape[:3], dtype=np.uint8)
    samples = np.zeros((len(numbers), PATCHES, 3))
    for i, picture in enumerate(pictures.read(view, [int(n) for n in numbers]) if plate or seen else ()):
        shown = to_display(picture)
        if seen:
            samples[i] = patch_colors(shown, joints_in_space(inputs, int(numbers[i])), inputs.rig, inputs.source_rig, inputs.captured_to_calibrated, view)
        if plate:
            stack[i] = shown
            if joints is not None:
                covered[i] = people_cover(joints.read(view, int(numbers[i])), joints.joint_set, (width, height), params.joints_margin)
    if colors:
        yield Block(COLORS, typical_colors(samples), view)
    if plate:
        found = median_and_spread(stack, covered)
        del stack, covered
        x, y = (int(n) for n in np.array([pictures.size(v) for v in range(len(inputs.views.names))]).max(axis=0))
        if PLATE in inputs.facts:
            yield Block(PLATE, _padded(found[0], (y, x, 3)), view)
        if SPREAD in inputs.facts:
            yield Block(SPREAD, _padded(found[1], (y, x)), view)


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
    """Warnings about a small sample and about pictures that are not static."""
    if block.array == "survey/sample":
        found = int((block.data >= 0).sum())
        return [f"view {block.view}: only {found} frames in the sample; background plate, jitter and exposure want 5 or more"] if found < 5 else []
    known = block.data[(block.data > 0) & (block.data < UNKNOWN)] if block.array == "survey/spread" else np.zeros(0)
    if len(known):
        typical = float(np.median(known))
        if typical > UNSTEADY:
            return [f"view {block.view}: colours differ by {typical:.0f}/255 between frames all over the picture (bound {UNSTEADY:.0f}); the camera or the light is not static, do not use frames.matte: plate"]
    return []
