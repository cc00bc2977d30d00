"""Views with few partners: where their first search looks, and how what it leaves open is filled.

The hull of such a view is mostly the partner's silhouette where few others carve it, and its sides run along the
partner's rays: windows that follow them collapse to a column in the partner's picture. There they follow a plane
instead that faces both cameras alike.
What one camera of a pair sees and the other does not, nobody else sees either, and it belongs to the nearer or to the
farther of its surroundings. Joints tell which: a gap lies on the limb that its rays meet, as far off its capsule as was
measured elsewhere on that limb; and they allow the whole of the hull to be searched, in whose back phantoms lie, since
no surface is far behind a limb's bone. A partner farther than `NARROW` away leaves as much open as none.
Of a view without any partner nothing is measured. Its hull's surface is the nearest that the subject can be: limbs
behind it tell where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.depth.algorithms.pose_prior import first_met
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, Maps, surfaces
from posegaussian.stages.geometry.pairs import NARROW
from posegaussian.stages.geometry.projection import pixel_centres, rays
from posegaussian.stages.matching.bounds import Bounds, within_hull
from posegaussian.stages.matching.fuse import complete
from posegaussian.stages.matching.sampling import extend

FEW = 3
"""Views, at most, of which a hull is mostly one partner's silhouette. With seven photographs of `bust`, at whose ends
others carve, too, windows that follow the hull have 0.03 dB more."""
CORE = 0.4
"""Share of a limb's radius that rays do not meet by chance, however joints err."""
OWN = 0.12
"""Metres off a limb's front up to which a surface is that limb's. Of nine simulated people before two cameras 45
degrees apart, half of that behind its core has as many dB, with exact joints and with ones that are 3 cm off."""
FARTHEST = 3.0
"""Distances of the subject beyond which the plane that windows follow does not go, nor nearer than one over it."""


@dataclass(frozen=True, eq=False)
class Limbs:
    """What limbs say of one view's depth, [h, w]."""

    depth: np.ndarray
    """Metres of the first limb on each ray, 0 where it meets none."""
    which: np.ndarray
    """Which limb that is."""
    core: np.ndarray
    """Metres of the first limb's core on each ray, 0 where it meets none."""


def with_few_partners(geometry: Geometry, frame: Frame, hulls: Maps) -> dict[int, Limbs | None]:
    """Of the views with at most one partner within `NARROW`: what their limbs say, None where no joints are known."""
    found: dict[int, Limbs | None] = {}
    for v in geometry.views:
        if geometry.neighbours[v].views and sum(angle <= NARROW for angle in geometry.partner_angles(v)) <= 1:
            found[v] = _limbs(geometry, v, hulls[v][0] > 0, frame.flesh) if len(frame.flesh) else None
    return found


def _limbs(geometry: Geometry, view: int, wanted: np.ndarray, flesh: np.ndarray) -> Limbs:
    cores = np.concatenate([flesh[:, :6], CORE * flesh[:, 6:]], axis=1)
    return Limbs(*first_met(geometry.rig, view, wanted, flesh), first_met(geometry.rig, view, wanted, cores)[0])


def searched(
    geometry: Geometry, view: int, hull: tuple[np.ndarray, np.ndarray], in_front: float, few: dict[int, Limbs | None]
) -> tuple[Bounds, tuple[np.ndarray, np.ndarray]]:
    """Where the first search of a view looks, and the nearest and farthest depth [h, w] of all; `in_front` as of
    `within_hull`, `few` as of `with_few_partners`."""
    (near, far), bounds = hull, within_hull(*hull, in_front)
    if view not in few:
        return bounds, (bounds.near, far)
    limbs, carved_by_few = few[view], len(geometry.views) <= FEW
    guide = np.where(near > 0, _facing(geometry, view), 0).astype(np.float32) if carved_by_few else bounds.guide
    if limbs is None:
        return Bounds(guide, bounds.near, bounds.far), (bounds.near, far)
    last = np.where(limbs.core > 0, np.clip(limbs.core + OWN, near, far), far).astype(np.float32)
    return Bounds(guide, bounds.near, last), (bounds.near, last)


def _facing(geometry: Geometry, view: int) -> np.ndarray:
    """[h, w] depth of the plane through the subject that faces a view and its partners alike."""
    rig, centre = geometry.rig, geometry.centre
    towards = rig.centres[[view, *geometry.neighbours[view].views]] - centre
    normal = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).sum(axis=0)
    width, height = (int(n) for n in rig.size.max(axis=0))
    origin, directions = rays(pixel_centres((width, height)), rig.intrinsics[view], rig.world_to_camera[view])
    slope, distance = directions @ normal, geometry.distance(view)
    depth = (centre - origin) @ normal / np.where(np.abs(slope) < 1e-6, 1e-6, slope)
    return np.clip(np.where(depth > 0, depth, np.inf), distance / FARTHEST, distance * FARTHEST)


def unmatched(geometry: Geometry, hulls: Maps, flesh: np.ndarray) -> dict[int, np.ndarray]:
    """Depth [h, w] by view of what nothing was matched of: the hull's rounded surface; of a view without a partner the
    limbs behind it, beyond whose outlines the nearest one of the picture."""
    out = surfaces(geometry, hulls)
    for v in geometry.views:
        if len(flesh) and not geometry.neighbours[v].views:
            limbs = _limbs(geometry, v, hulls[v][0] > 0, flesh)
            near, far = hulls[v]
            on = np.clip(extend(limbs.depth, limbs.depth > 0), near, far)
            out[v] = np.where(near > 0, np.maximum(on, out[v]), out[v]).astype(np.float32)
    return out


def completed(
    matched: tuple[np.ndarray, np.ndarray],
    hull: tuple[np.ndarray, np.ndarray],
    surface: np.ndarray,
    limbs: Limbs | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and confidence [h, w] as of `posegaussian.stages.matching.fuse.complete`, but gaps on the limbs that their
    rays meet, where these are known."""
    depth, confidence = complete(*matched, *hull, surface)
    if limbs is None:
        return depth, confidence
    gap = (matched[0] == 0) & (hull[0] > 0) & (limbs.depth > 0)
    off = np.where(matched[0] > 0, matched[0] - limbs.depth, np.inf)
    for k in np.unique(limbs.which[gap]):
        own = limbs.which == k
        known, open_ = own & (np.abs(off) < OWN), own & gap
        depth[open_] = limbs.depth[open_] + (extend(np.where(known, off, 0), known)[open_] if known.any() else 0)
    return np.where(gap, np.clip(depth, *hull), depth).astype(np.float32), confidence
