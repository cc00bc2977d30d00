"""What a run will make of a capture, by the run's own decisions: an inspection predicts with nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from posegaussian.stages.camera_paths.stretch import Stretch, best_stretch
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.trust import TrustSetting
from posegaussian.stages.depth.methods.declaration import DepthMethod
from posegaussian.stages.depth.methods.registry import METHODS
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.geometry.pairs import PairReport, PairVerdict, choose_pairs, pair_report
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.matching.sweep import nearest
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.storage.model.cameras import Rig


@dataclass(frozen=True, eq=False)
class Planned:
    """Cameras and resolved choices of a run."""

    rig: Rig
    """All cameras, of `frames/*`."""
    active: tuple[int, ...]
    """Views whose pictures are worked on, in the order of the footage."""
    sources: tuple[int, ...]
    """Those of them that are reconstructed from."""
    depth: DepthParams
    """Settings of depth, with `method: auto` resolved."""
    matte: tuple[str, str]
    """What `frames.matte` comes to, and why."""
    estimator: tuple[str, str]
    """What `detection.estimator` comes to, and why."""
    facts: Facts
    """What the capture has."""
    trust: TrustSetting = "auto"
    """Which cameras are believed whatever they show."""
    left_out: str = ""
    """One sentence on pictures of left-out source views, where anything is known of them."""
    sample: int = SurveyParams().sample
    """Frames that the survey looks at."""

    @cached_property
    def source_places(self) -> tuple[int, ...]:
        """Indices in the footage of those that are reconstructed from."""
        return tuple(self.active.index(v) for v in self.sources)

    def masks_against(self, place: int, masks: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Of masks by index in the footage, those that tell whether the one at `place` is right: its own and those that
        a run carves with."""
        return {v: mask for v, mask in masks.items() if v == place or v in self.source_places}

    def masks_carving(self, masks: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Of masks by index in the footage, those that a run carves with."""
        return {v: mask for v, mask in masks.items() if v in self.source_places}

    @property
    def method(self) -> DepthMethod:
        """The depth method of the run."""
        return METHODS[self.depth.method]

    @property
    def matches(self) -> bool:
        """Whether pictures are compared with each other at all."""
        return self.method.matches and len(self.sources) > 1

    @cached_property
    def reports(self) -> list[PairReport]:
        """The verdict on every pair of the footage, views counted as in the rig."""
        return pair_report(self.rig, self.active, self.depth.max_angle, self.sources or None)

    @cached_property
    def source_reports(self) -> list[PairReport]:
        """That of those pairs that a run may match."""
        return pair_report(self.rig, self.sources, self.depth.max_angle)

    @cached_property
    def partners(self) -> dict[int, list[int]]:
        """With which views each source view is compared; as the depth stage takes them."""
        if not self.matches:
            return {v: [] for v in self.sources}
        if not self.method.rectifies:
            centre = look_at_point(self.rig.subset(self.sources))
            return {
                v: list(nearest(self.rig, v, self.sources, self.depth.pairs, self.depth.max_angle, centre))
                for v in self.sources
            }
        return choose_pairs(self.rig, self.sources, self.depth.pairs, self.depth.max_angle)

    @cached_property
    def matched(self) -> frozenset[tuple[int, int]]:
        """Pairs that are compared, lower index first."""
        return frozenset((min(a, b), max(a, b)) for a, found in self.partners.items() for b in found)

    @cached_property
    def refused(self) -> list[PairReport]:
        """Pairs of sources that cannot be matched, with the reason; a method that compares pictures without
        rectifying them asks for no rows."""
        no_row_needed = self.method.matches and not self.method.rectifies
        barred = [r for r in self.source_reports if not r.usable and tuple(sorted(r.views)) not in self.matched]
        return [
            r
            for r in barred
            if not no_row_needed or r.angle > self.depth.max_angle or r.verdict is PairVerdict.COINCIDENT
        ]

    @cached_property
    def alone(self) -> tuple[int, ...]:
        """Source views that are compared with no other."""
        served = {v for pair in self.matched for v in pair}
        return tuple(v for v in self.sources if v not in served)

    @cached_property
    def stretch(self) -> Stretch | None:
        """Where pictures lie between two cameras that can be matched and stand near enough."""
        return best_stretch(self.rig, self.sources, self.depth.max_angle)

    @cached_property
    def nearest(self) -> dict[int, tuple[float, int]]:
        """Degrees to the nearest partner of each source view that has one, and who that is."""
        angles = {tuple(sorted(r.views)): r.angle for r in self.source_reports}
        return {v: min((angles[min(v, w), max(v, w)], w) for w in found) for v, found in self.partners.items() if found}

    @cached_property
    def gap(self) -> float | None:
        """Degrees between the neighbours between which pictures are best; without a stretch those of the worst
        served view; None where nothing is matched."""
        if not self.nearest:
            return None
        return self.stretch.widest if self.stretch is not None else max(self.nearest.values())[0]

    def names(self, *views: int) -> str:
        """Names of views, one after the other."""
        return ", ".join(self.rig.names[v] for v in views)
