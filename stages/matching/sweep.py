"""The offset sweep of one view: where along each ray, around a guide surface, do the neighbours' pictures agree?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.pairs import MIN_BASELINE, angle_at, enough, seen_bodies, share_shown
from posegaussian.stages.geometry.subject import up_direction
from posegaussian.stages.imaging.part import part_around
from posegaussian.stages.matching.aggregate import aggregate, minimum
from posegaussian.stages.matching.bounds import Bounds, inverse
from posegaussian.stages.matching.cost import cost_volume
from posegaussian.stages.matching.fuse import transfer
from posegaussian.storage.model.cameras import Rig, to_integer_centres

NOISE = 2.0
"""Standard deviation of the pictures' noise, 1/255: weaker texture does not count."""
SMALL, LARGE = 14, 250
"""Penalties of an offset that changes by one label and by more, where a window that does not correlate costs 200."""
JUMP = 6.0
"""Px of disparity by which the guide may differ between neighbouring pixels of one surface."""
MOST = 160
"""Labels at most; a wider search takes wider steps."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """What a view is compared with."""

    views: tuple[int, ...]
    """K views."""
    transfers: np.ndarray
    """[K, 3, 4] from (x, y, 1, inverse depth) of the view to homogeneous pixels of a neighbour, integer centres."""
    motion: np.ndarray
    """[K] px that a point at the subject moves in a neighbour for 1/metre of inverse depth."""

    @classmethod
    def of(cls, rig: Rig, view: int, views: tuple[int, ...], centre: np.ndarray) -> Neighbours:
        """Of a view; the motion is that of the point `centre` [3], world metres."""
        transfers = np.stack([transfer(rig, view, k) for k in views]) if views else np.zeros((0, 3, 4))
        camera = rig.world_to_camera[view, :3] @ np.append(centre, 1.0)
        point = np.append(to_integer_centres(rig.intrinsics[view]) @ camera / camera[2], 1 / camera[2])
        here = transfers @ point
        moved = (transfers[:, :2, 3] - here[:, :2] / here[:, 2:] * transfers[:, 2:, 3]) / here[:, 2:]
        return cls(views, transfers, np.linalg.norm(moved, axis=1))


def nearest(
    rig: Rig, view: int, views: tuple[int, ...], count: int, max_angle: float, centre: np.ndarray
) -> tuple[int, ...]:
    """Those of the `views` that are compared with a view: the nearest in angle at the point `centre` [3], index by
    index, `count` of them and the close-ups that `posegaussian.stages.geometry.pairs.enough` adds.

    Left out are views at more than `max_angle` degrees and views so near that a pixel of motion is a tenth of the
    distance.
    """
    distance = float(np.linalg.norm(rig.centres[view] - centre))
    found = []
    for k in views:
        angle = round(angle_at(centre, rig.centres[view], rig.centres[k]), 1)
        if (
            k != view
            and angle <= max_angle
            and np.linalg.norm(rig.centres[k] - rig.centres[view]) >= MIN_BASELINE * distance
        ):
            found.append((angle, k))
    up = up_direction(rig.subset(views))
    nearest_first = [k for _, k in sorted(found)]
    return tuple(enough(nearest_first, count, lambda k: share_shown(*seen_bodies(rig, (view, k), centre, up))))


def sweep(
    pictures: dict[int, np.ndarray],
    sizes: np.ndarray,
    view: int,
    neighbours: Neighbours,
    bounds: Bounds,
    step: float,
    radius: int,
    share: float,
) -> np.ndarray:
    """Depth [h, w] float32 of a view, metres along its optical axis, 0 where nothing is found.

    Args:
        pictures: [channel, h, w] float32 by view, 1/255, mean near 0.
        sizes: [V, 2] (width, height) of all pictures.
        view: the view.
        neighbours: what it is compared with.
        bounds: where its surface can lie.
        step: px of motion in the neighbour that moves most, for one label.
        radius: half width of the matching window.
        share: see `cost_volume`.
    """
    wanted = bounds.guide > 0
    out = np.zeros(wanted.shape, np.float32)
    if not wanted.any() or not neighbours.views:
        return out
    box = part_around(wanted, 0)
    mask = np.ascontiguousarray(wanted[box])
    guide, low, high = (np.ascontiguousarray(inverse(a[box])) for a in (bounds.guide, bounds.far, bounds.near))
    pixel = 1.0 / float(neighbours.motion.max())
    offsets = labels((low - guide)[mask], (high - guide)[mask], step * pixel)
    others = np.stack([pictures[k] for k in neighbours.views])
    size = sizes[list(neighbours.views)].astype(np.float32)
    volume = cost_volume(
        np.ascontiguousarray(pictures[view][(slice(None), *box)]),
        mask,
        guide,
        low,
        high,
        offsets,
        others,
        size,
        neighbours.transfers,
        (box[1].start, box[0].start),
        radius,
        NOISE**2,
        share,
    )
    label = minimum(aggregate(volume, mask, guide / np.float32(JUMP * pixel), SMALL, LARGE), volume, mask)
    found = np.clip(guide + offsets[0] + label * (offsets[1] - offsets[0]), low, high)
    out[box] = inverse(np.where(label >= 0, found, 0))
    return out


def labels(low: np.ndarray, high: np.ndarray, step: float) -> np.ndarray:
    """[D] float32 offsets in steps of `step`, through 0, over all but the widest percent of the pixels' ranges [n];
    at most MOST of them, in wider steps."""
    least, most = min(float(np.percentile(low, 1)), 0.0), max(float(np.percentile(high, 99)), 0.0)
    step = max(step, (most - least) / (MOST - 5))
    return (np.arange(int(np.floor(least / step)) - 1, int(np.ceil(most / step)) + 2) * step).astype(np.float32)
