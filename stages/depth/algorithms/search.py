"""The settings of the depth stage that an algorithm may look at; which method they belong to is not among them."""

from __future__ import annotations

from typing import Protocol


class SearchSettings(Protocol):
    """`posegaussian.stages.depth.params.DepthParams` has them, each with its sentence."""

    @property
    def pairs(self) -> int:
        """Neighbouring views each view is compared with."""

    @property
    def max_angle(self) -> float:
        """Degrees at the subject between two views that are matched."""

    @property
    def consistency(self) -> float:
        """Px of disagreement above which a match is dropped."""

    @property
    def depth_range(self) -> tuple[float, float] | None:
        """Nearest and farthest depth, m; None: everything."""

    @property
    def subject_distance(self) -> float | None:
        """Metres from a single source camera to the subject; None: by its field of view."""
