"""Depth of all source views of one frame: hull, matching along it, mutual checks, and a second round along the result."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stages.depth.fuse import MATCHED, complete, fuse, transfer
from stages.depth.params import DepthParams
from stages.depth.sampling import disagreement, extend
from stages.depth.sgbm import Bounds, match
from stages.geometry.hull import foreground, searched_radius, visual_hull
from stages.geometry.pairs import choose_pairs
from stages.geometry.rectification import RectifiedPair, rectify
from stages.geometry.subject import look_at_point
from storage.rig import Rig

SEARCHED = 0.6
"""Share of the hull's thickness, in inverse depth, that is searched: a visible surface lies in the front half of its hull but for phantoms."""
RESIDUAL = 0.012
"""Half width of the second round's search, px over the picture's longer side: 6 px at 512."""
IN_FRONT = 0.006
"""Disparity by which a surface may lie in front of its hull, px over the picture's longer side: 3 px at 512, about what a
mask or a calibration that is a pixel off costs."""
FINE, FINEST = 768, 1.5
"""Pictures are matched at this size of their longer side, but enlarged by at most the second number: finer residuals, narrower windows."""
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
    pairs: dict[tuple[int, int], RectifiedPair]
    """Usable pairs in both orders."""

    @classmethod
    def of(cls, rig: Rig, views: tuple[int, ...], params: DepthParams, enlarge: bool = True) -> Geometry:
        """The geometry of the given views: each with its best usable neighbours, every pair in both orders.

        `enlarge` allows rectified pictures finer than their sources.
        """
        if not views:
            return cls(rig, views, np.zeros(3), 0.0, {})
        centre = look_at_point(rig.subset(views))
        partners = choose_pairs(rig, views, params.pairs, params.max_angle) if params.method == "sgbm" else {}
        ordered = sorted({order for a, found in partners.items() for b in found for order in ((a, b), (b, a))})
        scale = float(np.clip(FINE / rig.size[list(views)].max(), 1.0, FINEST if enlarge else 1.0))
        return cls(rig, views, centre, searched_radius(rig, list(views), centre), {(a, b): rectify(rig, a, b, centre, scale) for a, b in ordered})

    def distance(self, view: int) -> float:
        """Depth of the centre along a view's optical axis, metres."""
        return float(self.rig.rotations[view, 2] @ (self.centre - self.rig.centres[view]))

    def partners(self, view: int) -> list[int]:
        """The views this one is matched with."""
        return [b for a, b in self.pairs if a == view]

    def inverse_depth(self, view: int, share: float) -> float:
        """1/metres that make a disparity of `share` of the longer side in the view's least sensitive pair; 0 without a pair."""
        pixels = share * float(self.rig.size[view].max())
        return pixels / min((self.pairs[view, b].sensitivity for b in self.partners(view)), default=np.inf)


def has_silhouettes(rig: Rig, masks: dict[int, np.ndarray]) -> bool:
    """Whether any view's mask [h, w] leaves out a pixel of its picture; without one there is no hull."""
    return any(not foreground(m[: rig.size[v, 1], : rig.size[v, 0]]).all() for v, m in masks.items())


def hull_only(geometry: Geometry, frame: Frame) -> Maps:
    """Depth of the hull's surface by view; its confidence is 1/2 everywhere, since nothing tells good pixels from bad ones."""
    return {v: (near, np.where(near > 0, MATCHED, 0).astype(np.float32)) for v, (near, _) in _hulls(geometry, frame).items()}


def estimate(geometry: Geometry, frame: Frame, params: DepthParams, checked: bool = True) -> Maps:
    """Depth and confidence by view: matched between the hull's bounds twice, the gaps completed.

    The second round follows the first one's result and searches a few px around it. Unless `checked`, a match counts
    whatever the other view says.
    """
    inside, hulls = frame.inside, _hulls(geometry, frame)
    colors = {v: _beyond_silhouette(c, inside[v]) for v, c in frame.colors.items()}
    limits = {v: (_shifted(near, geometry.inverse_depth(v, IN_FRONT)), far) for v, (near, far) in hulls.items()}
    bounds = {v: Bounds(near, limits[v][0], _between(near, far, SEARCHED)) for v, (near, far) in hulls.items()}
    first = _completed(_round(geometry, colors, inside, bounds, params, checked), hulls)
    again = {v: _around(first[v][0], geometry.inverse_depth(v, RESIDUAL), *limits[v]) for v in hulls}
    return _completed(_round(geometry, colors, inside, again, params, checked), hulls)


def estimate_open(geometry: Geometry, frame: Frame, params: DepthParams, checked: bool = True) -> Maps:
    """Depth and confidence by view of pictures without silhouettes, where there is no hull.

    Searched is `params.depth_range`, or 0.6 to 2 times the distance of the point the cameras look at; a pixel without
    a match, or unless `checked` is False with one that does not hold in both directions, has depth 0.
    """
    inside, bounds = frame.inside, {}
    for v in geometry.views:
        near, far = params.depth_range or (RANGE[0] * geometry.distance(v), RANGE[1] * geometry.distance(v))
        # The windows stand upright at the middle of the range.
        bounds[v] = Bounds(*(np.where(inside[v], z, 0).astype(np.float32) for z in ((near * far) ** 0.5, near, far)))
    return _round(geometry, frame.colors, inside, bounds, params, checked)


def _hulls(geometry: Geometry, frame: Frame) -> Maps:
    return {v: visual_hull(geometry.rig, v, frame.masks, geometry.centre, geometry.radius) for v in geometry.views}


def _beyond_silhouette(color: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The picture with the nearest foreground colour in place of the background, so that windows see no false edge.

    The outermost pixel of the foreground is replaced too: it is mixed with the background.
    """
    return extend(color, cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def _between(near: np.ndarray, far: np.ndarray, share: float) -> np.ndarray:
    """Depth at a share of the way from near to far in inverse depth, 0 where near is 0."""
    known = near > 0
    inverse = (1 - share) / np.where(known, near, 1) + share / np.where(known, far, 1)
    return np.where(known, 1 / inverse, 0).astype(np.float32)


def _shifted(depth: np.ndarray, inverse_depth: float) -> np.ndarray:
    """Depth moved towards the camera by a step of inverse depth (away for a negative one), 0 where it is 0."""
    known = depth > 0
    return np.where(known, 1 / np.maximum(1 / np.where(known, depth, 1) + inverse_depth, 1e-3), 0).astype(np.float32)


def _around(guide: np.ndarray, reach: float, near: np.ndarray, far: np.ndarray) -> Bounds:
    """Bounds a step of inverse depth to both sides of a guide, between near and far."""
    closer = np.maximum(_shifted(guide, reach), near)
    return Bounds(guide, closer, np.maximum(closer, np.minimum(_shifted(guide, -reach), far)))


def _round(geometry: Geometry, colors: dict[int, np.ndarray], inside: dict[int, np.ndarray], bounds: dict[int, Bounds], params: DepthParams, checked: bool) -> Maps:
    """One round of matching all pairs in both directions: what holds in both (unless `checked`, all), fused by view."""
    found = {(a, b): match(pair, colors[a], colors[b], inside[a], bounds[a]) for (a, b), pair in geometry.pairs.items()}
    out = {}
    for v in geometry.views:
        partners = geometry.partners(v)
        if not partners:
            out[v] = (np.zeros_like(bounds[v].guide), np.zeros_like(bounds[v].guide))
            continue
        scales = np.array([geometry.pairs[v, b].sensitivity for b in partners])
        errors = [_errors(geometry, found, v, b, s, checked) for b, s in zip(partners, scales, strict=True)]
        out[v] = fuse(np.stack([found[v, b] for b in partners]), np.stack(errors), scales, params.consistency)
    return out


def _errors(geometry: Geometry, found: dict[tuple[int, int], np.ndarray], view: int, partner: int, scale: float, checked: bool) -> np.ndarray:
    """[h, w] px by which the partner contradicts a view's matches, infinite without one; 0 for every match unless `checked`."""
    if checked:
        return disagreement(found[view, partner], found[partner, view], transfer(geometry.rig, view, partner), scale)
    return np.where(found[view, partner] > 0, 0.0, np.inf).astype(np.float32)


def _completed(rounds: Maps, hulls: Maps) -> Maps:
    return {v: complete(*rounds[v], *hulls[v]) for v in rounds}
