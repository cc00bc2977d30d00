"""Whether cameras stand turned against what is written down: pictures of left-out views, drawn with both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.contract.judged import CALIBRATION, mean_scores
from posegaussian.stages.imaging.calibration import ALONE_GAIN, LEAST_GAIN, NEAR, SMALLEST, as_linked, told_by
from posegaussian.stages.imaging.small_turns import LINKS, Links, fitted_turns
from posegaussian.stages.judge.body import body_facts
from posegaussian.stages.judge.drawing import scores, with_gaussians
from posegaussian.stages.judge.footage import frames_of
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.refinement.frame import FrameReader
from posegaussian.stages.refinement.params import RefinementParams
from posegaussian.stages.refinement.steps.turning import turns_with_gaussians


class Tried(NamedTuple):
    """Cameras that stand in one way."""

    frames: Frames
    """A few frames, as `frames_of` gives them."""
    made: Frames
    """The same with Gaussians."""
    drawn: np.ndarray
    """[picture, measure] of left-out views."""


class Turned(NamedTuple):
    """How cameras stand as they are written down, and turned."""

    taken: Tried
    """What all else is compared with: the better, or turned where it was not asked which is."""
    turns: np.ndarray
    """[V, 3] rad of the cameras that are turned."""
    drawn: np.ndarray
    """[picture, 2, measure] as cameras are written down, and turned."""


def turns_by_links(inputs: Inputs) -> np.ndarray:
    """[V, 3] rad that fit what pairs of source views both see; 0 of every other camera."""
    sources = list(inputs.views.sources)
    turns = np.zeros((len(inputs.rig), 3))
    turns[sources] = fitted_turns(inputs.rig.subset(sources), _links(inputs, sources))
    return turns


def _links(inputs: Inputs, sources: list[int]) -> Links:
    """What pairs of the source views both see."""
    return Links.of(np.stack([inputs.read(LINKS, v) for v in sources])[:, sources])


def near(inputs: Inputs) -> bool:
    """Whether what pairs share lies on each other's lines, as far as it tells, in pictures that can tell more."""
    sources = list(inputs.views.sources)
    told = told_by(as_linked(inputs.source_rig.subset(sources)), _links(inputs, sources))
    return told is not None and told[1] <= NEAR and inputs.rig.size.max() >= SMALLEST


def as_filmed(inputs: Inputs, most: int, method: str, views: list[int]) -> Turned:
    """At most so many frames with the cameras as they draw left-out `views` better by a depth method: as they are
    written down, or turned: by what pairs of them share, unless they lie near that anyhow, and, where that is better,
    from there on with the Gaussians. Turned, whatever is better, where that is not asked."""

    def tried(turns: np.ndarray | None) -> Tried:
        frames = frames_of(inputs, most, turns)
        made = with_gaussians(frames, inputs.settings["depth"], method, body_facts(inputs, method))
        return Tried(frames, made, scores(made, frames.read("frames/color"), views, Facts()))

    def compared(one: Tried, other: Tried, turns: np.ndarray, least: float) -> Turned:
        asked = CALIBRATION in inputs.facts
        taken = one if asked and _gain(other, one) < least else other
        return Turned(taken, turns, np.stack([one.drawn, other.drawn], axis=1))

    written = tried(None)
    if near(inputs):
        turns = turns_together(written.made)
        return compared(written, tried(turns), turns, ALONE_GAIN)
    turns = turns_by_links(inputs)
    turned = tried(turns)
    if _gain(turned, written) >= LEAST_GAIN:
        together = turns + turns_together(turned.made)
        further = tried(together)
        turned, turns = (further, together) if _gain(further, turned) >= LEAST_GAIN else (turned, turns)
    return compared(written, turned, turns, LEAST_GAIN)


def turns_together(made: Frames) -> np.ndarray:
    """[V, 3] rad by which cameras turn together with the Gaussians of all frames."""
    reader = FrameReader(made, RefinementParams())
    read = [reader.frame(f) for f in made.partition]
    return turns_with_gaussians(
        made.rig, [(f.gaussians, f.filmed, (*f.plan.pupils, f.plan.judge)) for f in read if f.plan is not None]
    )


def _gain(one: Tried, other: Tried) -> float:
    """By how many dB one draws left-out views better than the other; 0 where none could be drawn."""
    means = mean_scores(np.stack([other.drawn, one.drawn], axis=1))
    return 0.0 if means is None else float(means[1, 0] - means[0, 0])
