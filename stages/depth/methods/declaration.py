"""What a depth method declares: the setting, what the stage reads, its refusals and its notes follow from it.

Declarations are read wherever settings are, so a method imports what it computes with inside its function: a plan
loads neither OpenCV nor Numba.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.depth.algorithms.search import SearchSettings

if TYPE_CHECKING:
    from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, Maps

OfFrame = Callable[["Geometry", "Frame", SearchSettings, bool], "Maps"]
"""`(geometry, frame, settings, checked)` -> depth and confidence [h, w] of all views of one frame; unless `checked`, a
match counts whatever the other view says."""
OfView = Callable[[Inputs, SearchSettings, int], tuple[np.ndarray, np.ndarray]]
"""`(inputs, settings, view)` -> depth and confidence [F, h, w] of one view, from its own arrays alone."""


def nothing(facts: Facts) -> str | None:
    """The answer of a method that every capture can serve, or that `auto` never takes."""
    return None


@dataclass(frozen=True)
class DepthMethod:
    """One way to depth. It has either `of_frame` or `of_view`."""

    name: str
    """Value of `depth.method`."""
    sentence: str
    """What it does, in a few words without a full stop, for the setting's description."""
    of_frame: OfFrame | None = None
    """Computes all source views of one frame together."""
    of_view: OfView | None = None
    """Computes one view by itself."""
    reads: tuple[str, ...] = ()
    """Arrays of the source views that it reads beside the masks."""
    lacks: Callable[[Facts], str | None] = nothing
    """What this capture lacks for it or has too much of, with what to do, as the rest of a sentence; or None."""
    auto: Callable[[Facts], str | None] = nothing
    """Why `auto` takes it for this capture, or None; the first method that has an answer is taken."""
    several: bool = False
    """Whether it takes views together and so needs two or more; limbs then bound its search."""
    matches: bool = False
    """Whether it compares pictures: matches are checked from the other view, and poorly matched views are reported."""
    rectifies: bool = False
    """Whether the pictures it compares are rectified pairs, which not every pair of cameras can be."""
    distance: Literal["known", "measured", "assumed"] = "known"
    """Of a single source view: whether depth says for certain how far away the subject is, says so and is compared
    with the assumed distance, or follows from that distance."""
    useful_angle: float = 20.0
    """Degrees at the subject from a single source view up to which pictures are worth looking at: see
    docs/measurements/monocular.md."""
    alone: str = ""
    """What the depth of a single source view is, for the plan's note; `{distance}` stands for metres to the subject."""
    working: int = 600
    """Bytes of working memory a pixel of one view (measured for matching one pair: half)."""
    quality: int | None = None
    """Its place among the quality levels, the worst first; None: it depends on the capture whether it can be
    chosen."""
    seconds: float = 0.0
    """CPU seconds for a source view of 512 x 512 px among eight (docs/measurements/quality.md); of methods that draw
    alike, `auto` takes the cheapest."""

    def alone_note(self, distance: float) -> str:
        """What the depth of a single source view `distance` m away is."""
        return self.alone.format(distance=f"{distance:.2g}") if self.alone else f"its depth is {self.name}"
