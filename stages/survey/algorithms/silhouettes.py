"""Do the masks fit together? Along the rim of a silhouette, a ray grazes the subject: what any other mask takes too
much of is missing first there."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.warp import Warp
from posegaussian.stages.silhouettes.agreement import agreement
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres
from posegaussian.storage.model.masks import foreground

RAYS = 200
"""Rim pixels of a picture that are asked, about."""
TOLERANCE = 0.5
"""Px by which a silhouette may be wider than drawn: exact masks then agree on every rim pixel."""


def masks_of(
    inputs: Inputs, number: int, warps: dict[int, Warp] | None = None, views: Sequence[int] | None = None
) -> dict[int, np.ndarray]:
    """[h, w] uint8 masks of one source frame in pixels of the rig, padded to the largest, by source view that has a
    picture of it, of all or some of them.

    `warps`: kept from one frame to the next, as undoing a lens takes longer than the rest.
    """
    pictures, reader, found = inputs.source("pictures"), inputs.source("masks"), {}
    warps = {} if warps is None else warps
    width, height = (int(n) for n in inputs.rig.size.max(axis=0))
    for v in inputs.views.sources if views is None else views:
        if number in pictures.numbers(v):
            (given,) = reader.read(v, [number])
            if v not in warps:
                warps[v] = Warp(v, pictures.size(v), inputs.source_rig, inputs.rig, inputs.captured_to_calibrated[v])
            warped = warps[v](given)
            found[v] = np.zeros((height, width), np.uint8)
            found[v][: warped.shape[0], : warped.shape[1]] = warped
    return found


def agreeing_share(rig: Rig, masks: dict[int, np.ndarray], view: int) -> float | None:
    """Share of the rim pixels of a view's mask whose rays the other masks [h, w] leave something of; None without a rim
    or another mask.

    Masks that are all too small by the same width agree: that cannot be seen.
    """
    views = sorted(masks)
    inside = foreground(masks[view])
    rows, columns = np.nonzero(inside & (cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0))
    centre = look_at_point(rig.subset(views))
    others = Silhouettes.of(rig, {v: masks[v] for v in views if v != view}, centre, searched_radius(rig, views, centre))
    if not len(rows) or not others.views:
        return None
    some = slice(None, None, max(1, len(rows) // RAYS))
    origin, directions = rays(
        points_from_integer_centres(np.stack([columns[some], rows[some]], axis=-1)),
        rig.intrinsics[view],
        rig.world_to_camera[view],
    )
    return float((others.ends(origin, directions, (TOLERANCE, TOLERANCE), votes=False)[:, 0] > 0).mean())


def odd_one_out(rig: Rig, masks: dict[int, np.ndarray]) -> int | None:
    """Of masks [h, w] by view the only one that contradicts the others, which agree without it; None where there is
    none, or that is not clear. A mask that lacks half of somebody is contradicted by none, and all are by it."""
    if not masks:
        return None
    views = sorted(masks)
    centre = look_at_point(rig.subset(views))
    silhouettes = Silhouettes.of(rig, masks, centre, searched_radius(rig, views, centre))
    return next(iter(set(views) - agreement(rig, masks, silhouettes).carving), None)


def share_left(rig: Rig, masks: dict[int, np.ndarray], view: int, odd: int | None) -> float | None:
    """As `agreeing_share` of a view's mask, without the `odd` one among the others; of the odd one itself the mean of
    what is left of theirs with it."""
    if view != odd:
        return agreeing_share(rig, {v: m for v, m in masks.items() if v != odd}, view)
    left = [agreeing_share(rig, masks, v) for v in masks if v != odd]
    return float(np.mean([s for s in left if s is not None] or [0.0]))
