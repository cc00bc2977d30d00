"""Outlines of given masks, redrawn along the edges that the pictures have.

Masks of a segmentation network follow the subject by a pixel or two, in waves, rounded at fingers and hems, with a
piece of floor at the feet. The colours on both sides of an outline and the picture's edges tell better where it is, but
not everywhere: against masks that are right they err by a third of a pixel themselves. So it is measured how much of an
edge there is across the outlines as they are given, and across redrawn ones.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from posegaussian.stages.frames.edge_matte import (
    along_edges,
    compared_beyond,
    distance_to,
    logit,
    soft_edge,
    without_specks,
)
from posegaussian.stages.geometry.consistency import change_across, typical_offset
from posegaussian.stages.geometry.subject import STATURE
from posegaussian.stages.imaging.outline import moved
from posegaussian.stages.imaging.part import part_around
from posegaussian.storage.model.masks import foreground

REACH = 0.025
"""Metres by which an outline is moved, about. Of people 440 px tall, cut out by hand or exactly and then spoilt as a
network does, 0.02 to 0.03 leaves least beside the true outline."""
LEAST_REACH = 2.0
"""Px, however small the subject is."""
DOUBT = 0.1
"""How often a mask is wrong about a pixel beside its outline."""
FIRM_OUTSIDE, FIRM_INSIDE = -12.0, 2.0
"""Log odds added beyond the reach, where the mask is believed: clothes may match the backdrop there."""
COLORS = 3.0
"""Weight of what colours tell, over that beside the segmentation of an estimator of joints, which looked at them."""
LOOKED_AT = 640
"""Px of the longer side of the part around a subject in which edges are measured."""
BORDER = 3
"""Px from a picture's border where an outline is the border's."""


class Slopes(NamedTuple):
    """How much of an edge there is across outlines: 1/255 a px, mean of their points. Where stripes reach the outline
    half of its points have little, and a median flips between the halves."""

    given: float
    """As they are given, moved as a whole to where pictures change most (what `outline_correction` does)."""
    redrawn: float
    """Redrawn."""


def redrawn(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """A mask [h, w] uint8 whose outlines follow the edges of its picture [h, w, 3] uint8 sRGB; as it is where nobody is
    in it.

    Metres are those of somebody who stands: the longer side of what the mask covers.
    """
    inside = foreground(mask)
    if not inside.any():
        return mask
    scale = max(float(np.ptp(at)) + 1 for at in np.nonzero(inside)) / STATURE
    reach = max(LEAST_REACH, REACH * scale)
    box = part_around(mask > 0, compared_beyond(scale) + round(2 * reach))
    shown, given, inside = (np.ascontiguousarray(a[box]) for a in (picture, mask, inside))
    prior = _prior(given, inside, reach)
    found = without_specks(along_edges(shown, prior, scale, None, COLORS) > 0, prior > 0)
    out = np.zeros_like(mask)
    out[box] = soft_edge(shown, found | _lost(inside, found))
    return out


def slopes(picture: np.ndarray, mask: np.ndarray) -> Slopes | None:
    """How much of an edge a mask [h, w] uint8 has across its outlines in its picture [h, w, 3] uint8, and would have;
    None where it has none."""
    box = part_around(foreground(mask), LOOKED_AT // 8)
    shown, given = np.ascontiguousarray(picture[box]), np.ascontiguousarray(mask[box])
    smaller = LOOKED_AT / max(*given.shape, 1)
    if 0 < smaller < 1:
        shown, given = (
            cv2.resize(a, None, fx=smaller, fy=smaller, interpolation=cv2.INTER_AREA) for a in (shown, given)
        )
    change = change_across(shown, given) if foreground(given).any() else np.zeros(0)
    if not len(change):
        return None
    at_edge = moved(given, typical_offset(change))
    found = [_slopes_across(shown, outlined) for outlined in (at_edge, redrawn(shown, at_edge))]
    return Slopes(*(float(np.mean(f)) for f in found)) if all(len(f) for f in found) else None


def _prior(mask: np.ndarray, inside: np.ndarray, reach: float) -> np.ndarray:
    """[h, w] float32 log odds of a mask [h, w] uint8, whose foreground is `inside` [h, w] bool, before its picture is
    looked at: undecided along its outline, firm farther from it than it is moved."""
    soft = cv2.GaussianBlur(mask.astype(np.float32) / np.float32(255), (0, 0), reach / 3)
    outside, within = (np.clip(distance_to(a) / reach - 0.5, 0, 1) for a in (inside, ~inside))
    return np.asarray(logit(soft, DOUBT) + FIRM_OUTSIDE * outside + FIRM_INSIDE * within, np.float32)


def _lost(inside: np.ndarray, found: np.ndarray) -> np.ndarray:
    """[h, w] bool: parts of a mask [h, w] bool of which nothing was found [h, w] bool: a ball in the air."""
    count, labels = cv2.connectedComponents(inside.astype(np.uint8), connectivity=8)
    lost = np.bincount(labels[found], minlength=count) == 0
    lost[0] = False
    return np.asarray(lost[labels])


def _slopes_across(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """[n] how much the colours of a picture [h, w, 3] change across the outline of a mask [h, w], 1/255 a px, at its
    pixels."""
    inside = foreground(mask)
    away = np.where(inside, -distance_to(~inside), distance_to(inside)).astype(np.float32)
    rim = np.abs(away) < 1.5
    rim[:BORDER], rim[-BORDER:], rim[:, :BORDER], rim[:, -BORDER:] = False, False, False, False
    normal, change = _gradient(away, 1.5)[:, rim], _gradient(picture.astype(np.float32), 1.0)[:, rim]
    normal = normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-6)
    return np.asarray(np.linalg.norm((change * normal[..., None]).sum(axis=0), axis=1))


def _gradient(field: np.ndarray, blur: float) -> np.ndarray:
    """[2, h, w, ...] float32 change of a field [h, w, ...] float32 a px to the right and downwards, blurred by px."""
    smooth = cv2.GaussianBlur(field, (0, 0), blur)
    return np.stack([cv2.Sobel(smooth, cv2.CV_32F, *to, scale=1 / 8) for to in ((1, 0), (0, 1))])
