"""What one frame's depth is made from: its pictures and masks, what follows from the cameras alone, and the hull."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from posegaussian.stages.depth.algorithms.pose_prior import bounded
from posegaussian.stages.depth.algorithms.relief import relief
from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.geometry.pairs import alone, angle_at, choose_pairs
from posegaussian.stages.geometry.rectification import RectifiedPair, rectify
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.stages.matching.fuse import MATCHED
from posegaussian.stages.matching.sweep import Neighbours, nearest
from posegaussian.stages.silhouettes.agreement import FEWEST, settled
from posegaussian.stages.silhouettes.hidden import without_hidden
from posegaussian.stages.silhouettes.hull import searched_radius, visual_hull
from posegaussian.stages.silhouettes.places import BELIEVED
from posegaussian.stages.silhouettes.rounding import rounded
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import foreground

FINE, FINEST = 768, 1.5
"""Pictures are matched at this size of their longer side, but enlarged by at most the second number: finer
residuals, narrower windows."""
RANGE = (0.6, 2.0)
"""Depths searched without masks, over the distance of the point the cameras look at."""
Maps = dict[int, tuple[np.ndarray, np.ndarray]]
"""Two maps [h, w] float32 by view."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Pictures of one frame by view; views without a picture are missing."""

    colors: dict[int, np.ndarray]
    """[h, w, 3] uint8; empty where the method does not look at them."""
    masks: dict[int, np.ndarray]
    """[h, w] uint8, 0..255."""
    limbs: np.ndarray = field(default_factory=lambda: np.zeros((0, 7)))
    """[N, 7] capsules of the subject's limbs (`posegaussian.stages.depth.algorithms.pose_prior`), where joints are
    believed."""
    flesh: np.ndarray = field(default_factory=lambda: np.zeros((0, 7)))
    """[M, 7] capsules of what of them is surely there."""
    contradicting: set[int] = field(default_factory=set)
    """Views whose masks as a whole contradict those of the others, filled in by `hulls`."""
    strays: set[int] = field(default_factory=set)
    """Views whose masks have parts that are not the subject, filled in by `hulls`."""

    @property
    def inside(self) -> dict[int, np.ndarray]:
        """[h, w] bool by view: foreground."""
        return {v: foreground(m) for v, m in self.masks.items()}


@dataclass(frozen=True, eq=False)
class Geometry:
    """What follows from the cameras alone."""

    rig: Rig
    """All cameras."""
    views: tuple[int, ...]
    """The views that have a picture."""
    centre: np.ndarray
    """[3] the point they look at, world metres."""
    radius: float
    """Metres around it in which the subject is searched."""
    params: SearchSettings
    """Settings of the search."""
    silhouettes: bool
    """Whether masks leave anything out; only then are rectified pictures finer than their sources."""

    @classmethod
    def of(cls, rig: Rig, views: tuple[int, ...], params: SearchSettings, silhouettes: bool = True) -> Geometry:
        """The geometry of the given views."""
        if not views:
            return cls(rig, views, np.zeros(3), 0.0, params, silhouettes)
        centre = look_at_point(rig.subset(views))
        return cls(rig, views, centre, searched_radius(rig, list(views), centre), params, silhouettes)

    @cached_property
    def pairs(self) -> dict[tuple[int, int], RectifiedPair]:
        """Rectified pairs in both orders: each view with its best usable partners."""
        if not self.views:
            return {}
        rig, params = self.rig, self.params
        partners = choose_pairs(rig, self.views, params.pairs, params.max_angle)
        ordered = sorted({order for a, found in partners.items() for b in found for order in ((a, b), (b, a))})
        scale = float(np.clip(FINE / rig.size[list(self.views)].max(), 1.0, FINEST if self.silhouettes else 1.0))
        up = up_direction(rig.subset(self.views))
        return {(a, b): rectify(rig, a, b, self.centre, scale, up) for a, b in ordered}

    @cached_property
    def neighbours(self) -> dict[int, Neighbours]:
        """What each view is compared with where nothing is rectified: the nearest views, whatever way they face."""
        rig, params, centre = self.rig, self.params, self.centre
        return {
            v: Neighbours.of(rig, v, nearest(rig, v, self.views, params.pairs, params.max_angle, centre), centre)
            for v in self.views
        }

    def partner_angles(self, view: int) -> list[float]:
        """Degrees at the subject between a view and each of its `neighbours`."""
        centres = self.rig.centres
        return [angle_at(self.centre, centres[view], centres[k]) for k in self.neighbours[view].views]

    def pixel(self, view: int) -> float:
        """1/metres that move a point by one px in the neighbour that moves most; 0 without a neighbour."""
        return 1.0 / float(self.neighbours[view].motion.max(initial=0.0) or np.inf)

    def distance(self, view: int) -> float:
        """Depth of the centre along a view's optical axis, metres."""
        return float(self.rig.rotations[view, 2] @ (self.centre - self.rig.centres[view]))

    def partners(self, view: int) -> list[int]:
        """The views this one is matched with."""
        return [b for a, b in self.pairs if a == view]

    def inverse_depth(self, view: int, share: float) -> float:
        """1/metres that make a disparity of `share` of the longer side in the view's least sensitive pair; 0 without
        a pair."""
        pixels = share * float(self.rig.size[view].max())
        return pixels / min((self.pairs[view, b].sensitivity for b in self.partners(view)), default=np.inf)


def has_silhouettes(rig: Rig, masks: dict[int, np.ndarray]) -> bool:
    """Whether any view's mask [h, w] leaves out a pixel of its picture; without one there is no hull."""
    return any(not foreground(m[: rig.size[v, 1], : rig.size[v, 0]]).all() for v, m in masks.items())


def hulls(geometry: Geometry, frame: Frame) -> Maps:
    """Nearest and farthest depth of the hull by view, 0 where there is none; the nearest moved on to the limbs, where
    there are any.

    A silhouette that contradicts all others carves nothing, and none does where something hides the subject; one vote
    is overruled only for views that are explained by the others. Of stray parts of masks there is no hull.
    """
    masks, silhouettes, found = settled(geometry.rig, frame.masks, geometry.centre, geometry.radius)
    frame.strays.update(v for v, m in masks.items() if m is not frame.masks[v])
    if len(geometry.views) >= FEWEST:
        wrong = (v for v in geometry.views if v not in found.carving or found.unexplained[v] >= BELIEVED)
        frame.contradicting.update(wrong)
    carving = without_hidden(geometry.rig, masks, silhouettes.kept(set(found.carving)), found.unexplained)
    ends = {
        v: visual_hull(geometry.rig, v, masks[v], carving, votes=found.unexplained.get(v, 1.0) < BELIEVED)
        for v in geometry.views
    }
    return bounded(geometry.rig, ends, {v: masks[v] for v in found.carving}, frame.limbs)


def hull_only(geometry: Geometry, frame: Frame) -> Maps:
    """Depth of the hull's surface by view, rounded; its confidence is 1/2 everywhere, since nothing tells good pixels
    from bad ones."""
    return {
        v: (depth, np.where(depth > 0, MATCHED, 0).astype(np.float32))
        for v, depth in surfaces(geometry, hulls(geometry, frame)).items()
    }


def reliefs(geometry: Geometry, frame: Frame) -> Maps:
    """Depth and confidence [h, w] of the views that nothing tells how far away the subject is from: their silhouettes,
    rounded, as deep as the point the cameras look at.

    Their hull reaches from one side of what is searched to the other. A view whose mask is empty tells nothing, and of
    a view alone there is no hull either.
    """
    rig, out = geometry.rig, {}
    seeing = tuple(v for v, inside in frame.inside.items() if inside.any())
    for v in alone(rig, seeing, geometry.params.max_angle):
        (width, height), mask = rig.size[v], frame.masks[v]
        depth, confidence = np.zeros(mask.shape, np.float32), np.zeros(mask.shape, np.float32)
        depth[:height, :width], confidence[:height, :width] = relief(
            mask[:height, :width], geometry.distance(v), float(rig.intrinsics[v, 0, 0])
        )
        out[v] = depth, confidence
    return out


def surfaces(geometry: Geometry, found: Maps) -> dict[int, np.ndarray]:
    """Depth [h, w] of the hull's surface by view, rounded as its outlines and the other cameras say
    (`posegaussian.stages.silhouettes.rounding`), from its `hulls`."""
    rig, out = geometry.rig, {}
    for v, (near, far) in found.items():
        (width, height), depth = rig.size[v], near.copy()
        towards = rig.centres[[u for u in geometry.views if u != v]] - geometry.centre
        others = towards / np.linalg.norm(towards, axis=1, keepdims=True) @ rig.rotations[v].T
        focal = float(rig.intrinsics[v, [0, 1], [0, 1]].mean())
        depth[:height, :width] = rounded(near[:height, :width], far[:height, :width], focal, others)
        out[v] = depth
    return out


def depth_range(geometry: Geometry, view: int, params: SearchSettings) -> tuple[float, float]:
    """Nearest and farthest depth searched in pictures without silhouettes, metres: the setting, or 0.6 to 2 times
    the distance of the point the cameras look at."""
    return params.depth_range or (RANGE[0] * geometry.distance(view), RANGE[1] * geometry.distance(view))
