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


class Turned(NamedTuple):
    """The better of both."""

    frames: Frames
    """A few frames, as `frames_of` gives them."""
    drawn: np.ndarray
    """[picture, 2, measure] as they are written down, and turned."""


def turns_of(inputs: Inputs) -> np.ndarray:
    """[V, 3] rad that fit what pairs of source views both see; 0 of every other camera."""
    sources = list(inputs.views.sources)
    links = Links.of(np.stack([inputs.read(LINKS, v) for v in sources])[:, sources])
    turns = np.zeros((len(inputs.rig), 3))
    turns[sources] = fitted_turns(inputs.rig.subset(sources), links)
    return turns


def as_filmed(inputs: Inputs, most: int, turns: np.ndarray, method: str, views: list[int]) -> Turned:
    """At most so many frames with the cameras as they draw left-out `views` better by a depth method."""
    tried = [frames_of(inputs, most), frames_of(inputs, most, turns)]
    drawn = []
    for frames in tried:
        made = with_gaussians(frames, inputs.settings["depth"], method, body_facts(inputs, method))
        drawn.append(scores(made, frames.read("frames/color"), views, Facts()))
    both = np.stack(drawn, axis=1)
    means = mean_scores(both)
    better = means is not None and means[1, 0] - means[0, 0] >= LEAST_GAIN
    return Turned(tried[int(better)], both)
