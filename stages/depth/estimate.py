"""Depth of all source views of one frame: hull, matching along it, mutual checks, and a second round along the result."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stages.depth.fuse import HULL, complete, fuse, transfer
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
"""Half width of the second round's search over the picture's longer side: 6 px at 512."""
RANGE = (0.5, 2.0)
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
    def of(cls, rig: Rig, views: tuple[int, ...], params: DepthParams) -> Geometry:
        """The geometry of the given views: each with its best usable neighbours, every pair in both orders."""
        if not views:
            return cls(rig, views, np.zeros(3), 0.0, {})
        centre = look_at_point(rig.subset(views))
        partners = choose_pairs(rig, views, params.pairs, params.max_angle) if params.method == "sgbm" else {}
        ordered = sorted({order for a, found in partners.items() for b in found for order in ((a, b), (b, a))})
        return cls(rig, views, centre, searched_radius(rig, list(views), centre), {(a, b): rectify(rig, a, b, centre, _scale(rig, a, b)) for a, b in ordered})

    def distance(self, view: int) -> float:
        """Depth of the centre along a view's optical axis, metres."""
        return float(self.rig.rotations[view, 2] @ (self.centre - self.rig.centres[view]))

    def partners(self, view: int) -> list[int]:
        """The views this one is matched with."""
        return [b for a, b in self.pairs if a == view]


import os


def _scale(rig,a,b):
    return float(np.clip(float(os.environ.get("MS",0)) / rig.size[[a, b]].max(), 1.0, float(os.environ.get("MX",4))))


def hull_only(geometry: Geometry, frame: Frame, params: DepthParams) -> Maps:
    """Depth and confidence of the hull's surface by view."""
    return {v: (near, np.where(near > 0, HULL, 0).astype(np.float32)) for v, (near, _) in _hulls(geometry, frame.masks).items()}


def estimate(geometry: Geometry, frame: Frame, params: DepthParams) -> Maps:
    """Depth and confidence by view.

    With masks: matched between the hull's bounds twice, gaps completed. When every mask is full there is no silhouette
    and no hull: depth is searched in `params.depth_range`, or in half to twice the distance of the point the cameras look
    at, and only mutually consistent pixels keep a depth.
    """
    inside = {v: foreground(m) for v, m in frame.masks.items()}
    if geometry.views and all(_full(geometry.rig, v, inside[v]) for v in geometry.views):
        return _round(geometry, frame.colors, inside, _ranges(geometry, inside, params), params)
    hulls = _hulls(geometry, frame.masks)
    colors = {v: _beyond_silhouette(c, inside[v]) for v, c in frame.colors.items()}
    NS=float(os.environ.get('NS',0))
    loose = {v: _in_front(geometry, v, near, NS) for v, (near, far) in hulls.items()}
    bounds = {v: Bounds(near, loose[v], _between(near, far, SEARCHED)) for v, (near, far) in hulls.items()}
    first = _completed(_round(geometry, colors, inside, bounds, params), hulls)
    again = {v: _around(geometry, v, first[v][0], loose[v],hulls[v][1]) for v in hulls}
    return _completed(_round(geometry, colors, inside, again, params), hulls)


def _hulls(geometry: Geometry, masks: dict[int, np.ndarray]) -> Maps:
    return {v: visual_hull(geometry.rig, v, masks, geometry.centre, geometry.radius, (float(os.environ.get('TOL',0)),1.5)) for v in geometry.views}


def _full(rig: Rig, view: int, inside: np.ndarray) -> bool:
    width, height = rig.size[view]
    return bool(inside[:height, :width].all())


def _ranges(geometry: Geometry, inside: dict[int, np.ndarray], params: DepthParams) -> dict[int, Bounds]:
    """Constant bounds by view, with the windows upright at the geometric middle of the range."""
    out = {}
    for v in geometry.views:
        near, far = params.depth_range or tuple(r * geometry.distance(v) for r in RANGE)
        out[v] = Bounds(*(np.where(inside[v], z, 0).astype(np.float32) for z in ((near * far) ** 0.5, near, far)))
    return out


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


def _around(geometry: Geometry, view: int, guide: np.ndarray, near: np.ndarray, far: np.ndarray) -> Bounds:
    """Bounds a few px of disparity to both sides of a guide, within the hull."""
    known = guide > 0
    scale = min((abs(geometry.pairs[view, b].baseline) * geometry.pairs[view, b].focal for b in geometry.partners(view)), default=1.0)
    reach = RESIDUAL * max(guide.shape) / scale
    inverse = 1 / np.where(known, guide, 1)
    closer = np.where(known, np.maximum(1 / (inverse + reach), near), 0)
    farther = np.where(known, np.minimum(1 / np.maximum(inverse - reach, 1e-3), far), 0)
    return Bounds(guide, closer.astype(np.float32), np.maximum(closer, farther).astype(np.float32))


def _in_front(geometry,view,near,share):
    known = near > 0
    scale = min((abs(geometry.pairs[view, b].baseline) * geometry.pairs[view, b].focal for b in geometry.partners(view)), default=1.0)
    return np.where(known,1/(1/np.where(known,near,1)+share*max(near.shape)/scale),0).astype(np.float32)

def _round(geometry: Geometry, colors: dict[int, np.ndarray], inside: dict[int, np.ndarray], bounds: dict[int, Bounds], params: DepthParams) -> Maps:
    """One round of matching all pairs in both directions: what holds in both, fused by view."""
    found = {(a, b): match(pair, colors[a], colors[b], inside[a], bounds[a]) for (a, b), pair in geometry.pairs.items()}
    out = {}
    for v in geometry.views:
        partners = geometry.partners(v)
        if not partners:
            out[v] = (np.zeros_like(bounds[v].guide), np.zeros_like(bounds[v].guide))
            continue
        scales = np.array([geometry.pairs[v, b].focal * abs(geometry.pairs[v, b].baseline) for b in partners])
        errors = [disagreement(found[v, b], found[b, v], transfer(geometry.rig, v, b), s) for b, s in zip(partners, scales, strict=True)]
        out[v] = fuse(np.stack([found[v, b] for b in partners]), np.stack(errors), scales, params.consistency)
    return out


def _completed(rounds: Maps, hulls: Maps) -> Maps:
    return {v: complete(*rounds[v], *hulls[v]) for v in rounds}
