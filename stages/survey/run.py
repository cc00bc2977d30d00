"""Kernel of the survey stage: the measures of one view that are asked for, from a recorded sample of its frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.detection.reader import EstimatedJoints, joint_reader
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.algorithms.plate import padded
from posegaussian.stages.survey.algorithms.sample import FEWEST, look, sample_numbers, worked_numbers
from posegaussian.stages.survey.measures.declaration import Sampled
from posegaussian.stages.survey.measures.registry import MEASURES
from posegaussian.stages.survey.measures.standing import STANDING
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.stages.survey.standing.standing import as_they_stand

FEW = 5
"""Frames of the sample in which light, noise and outlines are measured."""


def run(inputs: Inputs, params: SurveyParams) -> Iterator[Block]:
    """Yield sample [S] int64 of one view and, as far as they are asked for, its measures and its plate.

    What is asked for stands in `inputs.facts`. The sample lies evenly over the frames that are worked on, first and
    last included, that of the plate over the whole source; S is `params.sample`, padding is -1. Pictures are decoded
    only where they are looked at. Measures of a view that is no source are 0: nothing follows from it. All else is
    measured with the cameras as they are seen to stand, where that is asked for.
    """
    view = inputs.view
    assert view is not None, "the survey stage runs over views"
    if STANDING in inputs.facts:
        inputs = as_they_stand(inputs, params.sample)
    numbers = inputs.source("pictures").numbers(view)
    chosen = sample_numbers(worked_numbers(inputs, view), params.sample)
    yield Block("survey/sample", padded(chosen, (params.sample,), -1), view)
    sampled = Sampled(inputs, params, view, numbers, chosen, sample_numbers(chosen, FEW))
    looks = [m.look(sampled) for m in MEASURES if m.asked(inputs.facts)]
    ahead = _joints_ahead(inputs, view, looks) if ESTIMATED in inputs.facts else []
    yield from look(inputs, view, [*ahead, *looks])


def _joints_ahead(inputs: Inputs, view: int, looks: Sequence[Look]) -> list[Look]:
    """Have joints estimated in one pass over each view's pictures, instead of picture by picture; the view's own
    pass comes with its measures."""
    own, of_all = (
        np.unique(np.concatenate([*found, np.zeros(0, np.int64)]))
        for found in ([seen.joints for seen in looks], [seen.joints_of_all for seen in looks])
    )
    sources = inputs.views.sources
    if view in sources:
        own = np.union1d(own, of_all)
    if not len(own) and not len(of_all):
        return []
    estimated = joint_reader(inputs)
    assert isinstance(estimated, EstimatedJoints)
    for v in sources:
        if v != view:
            estimated.look_at(v, of_all)
    return [JointsLook(estimated, view, own)]


class JointsLook(Look):
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


def check(block: Block, params: SurveyParams) -> list[str]:
    """Warnings about a small sample, and those of the measures. None about a single frame: it is a still, and nothing
    could be done about it."""
    if block.array != "survey/sample":
        return [w for m in MEASURES if any(a.name == block.array for a in m.arrays) for w in m.check(block)]
    found = int((block.data >= 0).sum())
    if found >= FEWEST or found == 1:
        return []
    return [
        (
            f"view {block.view}: only {found} frames in the sample; background plate, jitter and exposure want"
            f" {FEWEST} or more"
        )
    ]
