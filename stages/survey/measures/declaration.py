"""What a survey measure declares: the stage's outputs, what it reads and when follow from it.

Declarations are read wherever settings are, so a measure imports what it computes with inside its functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.survey.algorithms.look import NO_FRAMES, Look
from posegaussian.storage.model.spec import ArraySpec

Source = Literal["joints2d", "joints3d", "masks"]


class SurveySettings(Protocol):
    """The settings of the stage that a measure may look at: `posegaussian.stages.survey.params.SurveyParams` has them,
    each with its sentence."""

    @property
    def sample(self) -> int:
        """Frames sampled evenly."""

    @property
    def joints_margin(self) -> float:
        """How far around limbs no background is learnt; 0: joints are not looked at."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """One view and its sample."""

    inputs: Inputs
    """All that the task may see."""
    params: SurveySettings
    """Settings of the stage."""
    view: int
    """Index of the view."""
    numbers: np.ndarray
    """[n] source frames of which the view has a picture."""
    chosen: np.ndarray
    """[m] the sampled ones of those that are worked on."""
    few: np.ndarray
    """A few of them, for what changes little from frame to frame."""

    @cached_property
    def compared(self) -> np.ndarray:
        """[c] the sampled ones in which views are compared: those with somebody, as far as given masks tell."""
        from posegaussian.stages.survey.algorithms.sample import of_somebody

        return of_somebody(self.inputs, self.chosen) if self.is_source else self.chosen

    @property
    def is_source(self) -> bool:
        """Whether the view is reconstructed from; nothing follows from measures of another."""
        return self.view in self.inputs.views.sources

    def if_source(self, numbers: np.ndarray) -> np.ndarray:
        """The numbers of a source view, none of another."""
        return numbers if self.is_source else NO_FRAMES


def no_warnings(block: Block) -> list[str]:
    """The answer of a measure that is never in doubt."""
    return []


@dataclass(frozen=True)
class Measure:
    """One measure of the sequence, or constants that are made together."""

    arrays: tuple[ArraySpec, ...]
    """What it writes. `when` is the array's own name, or that of the one it comes with; `noted` where an effect asks
    for it."""
    look: Callable[[Sampled], Look]
    """Its look at one view."""
    sources: Callable[[SurveySettings], frozenset[Source]] = lambda params: frozenset()
    """What it looks at beside pictures, where the capture has it."""
    check: Callable[[Block], list[str]] = no_warnings
    """Warnings about one of its blocks."""

    def asked(self, facts: Facts) -> bool:
        """Whether any of its arrays is asked for."""
        return any(a.name in facts for a in self.arrays)


def of(*sources: Source) -> Callable[[SurveySettings], frozenset[Source]]:
    """The `sources` of a measure that looks at the same under any settings."""
    return lambda params: frozenset(sources)
