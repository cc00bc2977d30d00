"""Whether cameras stand turned against what is written down: pictures of left-out views, drawn with both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.contract.judged import mean_scores
from posegaussian.stages.imaging.calibration import LEAST_GAIN
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
    """The better of both."""

    better: Tried
    turns: np.ndarray
    """[V, 3] rad of the better of those that were tried."""
    drawn: np.ndarray
    """[picture, 2, measure] as cameras are written down, and turned by them."""


def turns_by_links(inputs: Inputs) -> np.ndarray:
    """[V, 3] rad that fit what pairs of source views both see; 0 of every other camera."""
    sources = list(inputs.views.sources)
    links = Links.of(np.stack([inputs.read(LINKS, v) for v in sources])[:, sources])
    turns = np.zeros((len(inputs.rig), 3))
    turns[sources] = fitted_turns(inputs.rig.subset(sources), links)
    return turns


def as_filmed(inputs: Inputs, most: int, method: str, views: list[int]) -> Turned:
    """At most so many frames with the cameras as they draw left-out `views` better by a depth method: as they are
    written down, or turned by what pairs of them share and, where that is better, from there on with the Gaussians."""

    def tried(turns: np.ndarray | None) -> Tried:
        frames = frames_of(inputs, most, turns)
        made = with_gaussians(frames, inputs.settings["depth"], method, body_facts(inputs, method))
        return Tried(frames, made, scores(made, frames.read("frames/color"), views, Facts()))

    turns = turns_by_links(inputs)
    written, turned = tried(None), tried(turns)
    if not _better(turned.drawn, written.drawn):
        return Turned(written, turns, np.stack([written.drawn, turned.drawn], axis=1))
    together = turns + turns_together(turned.made)
    further = tried(together)
    if _better(further.drawn, turned.drawn):
        turned, turns = further, together
    return Turned(turned, turns, np.stack([written.drawn, turned.drawn], axis=1))


def turns_together(made: Frames) -> np.ndarray:
    """[V, 3] rad by which cameras turn together with the Gaussians of all frames."""
    reader = FrameReader(made, RefinementParams())
    read = [reader.frame(f) for f in made.partition]
    return turns_with_gaussians(
        made.rig, [(f.gaussians, f.filmed, (*f.plan.pupils, f.plan.judge)) for f in read if f.plan is not None]
    )


def _better(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether pictures [picture, measure] are better than others by what is no chance."""
    means = mean_scores(np.stack([other, one], axis=1))
    return means is not None and bool(means[1, 0] - means[0, 0] >= LEAST_GAIN)
