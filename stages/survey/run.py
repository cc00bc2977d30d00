"""Kernel of the survey stage: background plate, colours and motion of one view, from a recorded sample of its
frames."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.detection.reader import EstimatedJoints, joint_reader
from posegaussian.stages.survey.joints import fit_of_view, joints_in_space, runs_of_joints
from posegaussian.stages.survey.light import light_beyond_white
from posegaussian.stages.survey.motion import jitter_and_motion, run_starts
from posegaussian.stages.survey.noise import noise_level
from posegaussian.stages.survey.outlines import outline_offsets, typical_offset
from posegaussian.stages.survey.params import (
    COLORS,
    JOINT_FIT,
    LIGHT,
    MOTION,
    NOISE,
    OUTLINES,
    PLATE,
    SILHOUETTES,
    SPREAD,
    SURFACE,
    SurveyParams,
)
from posegaussian.stages.survey.patches import PATCHES, patch_colors, typical_colors
from posegaussian.stages.survey.plate import UNKNOWN, PlateLook, padded
from posegaussian.stages.survey.sample import FEWEST, Look, look, sample_numbers, worked_numbers
from posegaussian.stages.survey.silhouettes import agreement_of_view
from posegaussian.stages.survey.surface import SurfaceLook

FEW = 5
"""Frames of the sample in which light, noise and outlines are measured."""
FEWER = 3
"""One in so many of the sampled frames begins a run in which estimated joints' motion is measured: looking costs."""
UNSTEADY = 12.0
"""Median spread of a whole picture, 1/255, above which camera or light are not static."""


def run(inputs: Inputs, params: SurveyParams) -> Iterator[Block]:
    """Yield sample [S] int64 of one view and, as far as they are asked for, its measures and its plate.

    What is asked for stands in `inputs.facts`. The sample lies evenly over the frames that are worked on, first and
    last included, that of the plate over the whole source; S is `params.sample`, padding is -1. Pictures are decoded
    only where they are looked at, and once. Measures of a view that is no source are 0: nothing follows from it.
    """
    view = inputs.view
    assert view is not None, "the survey stage runs over views"
    numbers = inputs.source("pictures").numbers(view)
    chosen = sample_numbers(worked_numbers(inputs, view), params.sample)
    yield Block("survey/sample", padded(chosen, (params.sample,), -1), view)
    runs = run_starts(numbers, chosen if "detected" not in inputs.facts else chosen[::FEWER])
    looks = list(_looks(inputs, params, view, numbers, chosen))
    if "detected" in inputs.facts:
        behind = [s.numbers for s in looks if isinstance(s, PlateLook)]
        looks = _look_ahead(inputs, view, chosen, runs, behind) + looks
    yield from look(inputs, view, looks)
    source = view in inputs.views.sources
    if MOTION in inputs.facts:
        found = jitter_and_motion(runs_of_joints(inputs, view, runs)) if source else (0.0, 0.0, 0)
        yield Block(MOTION, np.array(found, dtype=np.float64), view)
    if SILHOUETTES in inputs.facts:
        yield Block(SILHOUETTES, np.array([agreement_of_view(inputs, view, chosen)]), view)
    if JOINT_FIT in inputs.facts:
        yield Block(JOINT_FIT, fit_of_view(inputs, view, chosen), view)


def _looks(inputs: Inputs, params: SurveyParams, view: int, numbers: np.ndarray, chosen: np.ndarray) -> Iterator[Look]:
    """What is asked for of a view's pictures."""
    source, few = view in inputs.views.sources, sample_numbers(chosen, FEW)
    if inputs.facts & {PLATE, SPREAD}:
        joints = joint_reader(inputs) if "joints2d" in inputs.facts and params.joints_margin > 0 else None
        yield PlateLook(
            inputs, view, sample_numbers(numbers, params.sample), params.sample, joints, params.joints_margin
        )
    if COLORS in inputs.facts:
        yield ColorsLook(inputs, view, chosen if source and inputs.facts & {"joints2d", "joints3d"} else chosen[:0])
    if SURFACE in inputs.facts:
        yield SurfaceLook(inputs, view, chosen)
    if OUTLINES in inputs.facts:
        yield OutlinesLook(inputs, view, few if source else few[:0])
    if LIGHT in inputs.facts:
        yield LightLook(view, few if source else few[:0])
    if NOISE in inputs.facts:
        yield NoiseLook(view, few if source else few[:0])


def _look_ahead(
    inputs: Inputs, view: int, chosen: np.ndarray, runs: list[np.ndarray], behind: list[np.ndarray]
) -> list[Look]:
    """Have joints estimated in one pass over each view's pictures, instead of picture by picture; the view's own
    pass comes with its measures."""
    estimated, sources = joint_reader(inputs), inputs.views.sources
    assert isinstance(estimated, EstimatedJoints)
    compared = chosen if inputs.facts & {COLORS, JOINT_FIT} else chosen[:0]
    for v in sources:
        if v != view:
            estimated.look_at(v, compared)
    own = [*behind, *([compared, *(runs if MOTION in inputs.facts else [])] if view in sources else [])]
    return [JointsLook(estimated, view, np.unique(np.concatenate([*own, chosen[:0]])))]


class JointsLook:
    """Estimates the joints that others look up; nothing of its own."""

    def __init__(self, estimated: EstimatedJoints, view: int, numbers: np.ndarray) -> None:
        """Of one view."""
        self.numbers, self._estimated, self._view = numbers, estimated, view

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Estimate, unless this process has before."""
        self._estimated.see(self._view, number, shown)

    def blocks(self) -> Iterator[Block]:
        """None."""
        return iter(())


class ColorsLook:
    """survey/colors [192, 3] float32 of one view: `exposure.typical_colors`."""

    def __init__(self, inputs: Inputs, view: int, numbers: np.ndarray) -> None:
        """numbers: none for a view that is no source, or without joints."""
        self.numbers, self._inputs, self._view = numbers, inputs, view
        self._samples = np.zeros((len(numbers), PATCHES, 3))

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Colours of the patches in one frame."""
        i, inputs = int(np.searchsorted(self.numbers, number)), self._inputs
        space = joints_in_space(inputs, number)
        self._samples[i] = patch_colors(
            shown, space, inputs.rig, inputs.source_rig, inputs.captured_to_calibrated, self._view
        )

    def blocks(self) -> Iterator[Block]:
        """The colours."""
        yield Block(
            COLORS,
            typical_colors(self._samples) if len(self._samples) else np.zeros((PATCHES, 3), np.float32),
            self._view,
        )


class OutlinesLook:
    """survey/outlines [3] of one view: `outlines.typical_offset`."""

    def __init__(self, inputs: Inputs, view: int, numbers: np.ndarray) -> None:
        """numbers: none for a view that is no source."""
        self.numbers, self._masks, self._view = numbers, inputs.source("masks"), view
        self._offsets: list[np.ndarray] = []

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Offsets along the outline in one frame."""
        (mask,) = self._masks.read(self._view, [number])
        self._offsets.append(outline_offsets(shown, mask))

    def blocks(self) -> Iterator[Block]:
        """Their median and spread."""
        yield Block(OUTLINES, typical_offset(self._offsets), self._view)


class LightLook:
    """survey/light [2] of one view: the largest of each of `light.light_beyond_white`; (0, 1) without frames."""

    def __init__(self, view: int, numbers: np.ndarray) -> None:
        """numbers: none for a view that is no source."""
        self.numbers, self._view, self._found = numbers, view, [np.array([0.0, 1.0])]

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Light of one frame."""
        self._found.append(light_beyond_white(picture))

    def blocks(self) -> Iterator[Block]:
        """The brightest frame's."""
        yield Block(LIGHT, np.max(self._found[1:] or self._found, axis=0), self._view)


class NoiseLook:
    """survey/noise [1] of one view: the median of `noise.noise_level`; 0 without frames."""

    def __init__(self, view: int, numbers: np.ndarray) -> None:
        """numbers: none for a view that is no source."""
        self.numbers, self._view, self._found = numbers, view, list[float]()

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Noise of one frame."""
        self._found.append(noise_level(shown))

    def blocks(self) -> Iterator[Block]:
        """The median."""
        yield Block(NOISE, np.array([np.median(self._found) if self._found else 0.0]), self._view)


def check(block: Block, params: SurveyParams) -> list[str]:
    """Warnings about a small sample and about pictures that are not static."""
    if block.array == "survey/sample":
        found = int((block.data >= 0).sum())
        few = (
            f"view {block.view}: only {found} frames in the sample; background plate, jitter and exposure want"
            f" {FEWEST} or more"
        )
        return [few] if found < FEWEST else []
    known = block.data[(block.data > 0) & (block.data < UNKNOWN)] if block.array == SPREAD else np.zeros(0)
    if len(known):
        typical = float(np.median(known))
        if typical > UNSTEADY:
            moving = (
                f"view {block.view}: colours differ by {typical:.0f}/255 between frames all over the picture (bound"
                f" {UNSTEADY:.0f}); the camera or the light is not static, do not use frames.matte: plate"
            )
            return [moving]
    return []
