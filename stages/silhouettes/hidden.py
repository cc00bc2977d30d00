"""Where the subject stands behind something in one view: a post, a tripod, somebody else.

Its mask is empty there, rightly, and yet the subject is there: other views' silhouettes, which explain each other, are
contradicted by this one alone, all over a place. An outline that runs a little beside the others' contradicts them in
a thin line, and a gap that only this view sees into (between the legs) contradicts nobody.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.silhouettes.hull import OUTVOTED, Silhouettes, foreground, searched_radius
from posegaussian.stages.silhouettes.places import (
    AROUND,
    SAMPLE,
    agreed,
    contradicting,
    disc,
    few_carvers,
    foreground_rays,
    missed,
    without_say,
)
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres

STRIDE = 2
"""Px from one background pixel that is asked to the next."""
THIN = 0.004
"""Of the longer side, for every px of `STRIDE`: half the width of what is too thin to be something in front, which is
0.8 % of the side. Outlines differ by less. With half as much .90 in place of .82 of what a bar hides of a person of 512
px is found, but places are hidden, too, where masks are 1 % off on all sides, of which this hides none."""
CONTRADICTED = 0.5
"""Share of a place that must be contradicted. Posts of 6 to 20 cm before five scenes (8 and 6 cameras, 320 px): 0.62 to
1.0; cameras 1 px off, masks 1 px off, and everything at once: at most 0.42 of anything of the least size."""
LEAST = 0.02
"""Of the largest silhouette's area: the least that counts."""


def without_hidden(
    rig: Rig, masks: Mapping[int, np.ndarray], silhouettes: Silhouettes, unexplained: Mapping[int, float]
) -> Silhouettes:
    """The silhouettes of masks [h, w] uint8 by view, none of which carves where something stands before the subject.

    Unlike `posegaussian.stages.silhouettes.places.reconciled` it leaves outlines alone that are a little off: a hull
    that is matched against is better cut too close than left standing. `unexplained` as there. What two masks lack
    together is asked of each without the other.
    """
    contradicted = contradicting(rig, masks, silhouettes, unexplained)
    around = np.array([cv2.dilate(c, disc(AROUND)) for c in contradicted], np.uint8).reshape(contradicted.shape)
    places, heard = np.zeros(contradicted.shape, bool), without_say(silhouettes, around == 2)
    for i, view in enumerate(silhouettes.views):
        if contradicted[i].any():
            others = heard.kept({*silhouettes.views} - {view})
            places[i] = _place(rig, view, masks, others, contradicted[i])
            if places[i].any():  # thin parts of what is hidden, too: fingers, ankles
                places[i] |= around[i] > 0
    return without_say(silhouettes, places)


class Witnesses:
    """What the silhouettes of other views of a frame know of the subject in one view."""

    def __init__(self, rig: Rig, masks: Mapping[int, np.ndarray]) -> None:
        """Of masks [h, w] uint8 by view."""
        self._rig, self._masks = rig, {v: m for v, m in masks.items() if foreground(m).any()}
        views = sorted(self._masks)
        self._centre = look_at_point(rig.subset(views)) if views else np.zeros(3)
        self._radius = searched_radius(rig, views, self._centre) if views else 0.0

    def hidden(self, view: int, mask: np.ndarray) -> np.ndarray:
        """[h, w] bool: background of the view's mask [h, w] uint8 that stands before the subject, and what is between
        that and the subject. Nothing where the others are too few for one of them to be overruled."""
        own = Silhouettes.of(self._rig, {view: mask}, self._centre, self._radius)
        if not own.views or len(self._masks) + 1 < OUTVOTED:
            return np.zeros(mask.shape, bool)
        if not any(len(lost) for _, _, lost in self._lost(self._given, own, SAMPLE)):
            return np.zeros(mask.shape, bool)
        together = self._agreed.joined(own)
        contradicted = np.zeros(mask.shape, np.uint8)
        for u, origin, lost in self._lost(self._agreed, own, None):
            contradicted |= few_carvers(together, u, origin, lost)[-1] == 1
        return _place(self._rig, view, self._masks | {view: mask}, self._agreed, contradicted)

    @cached_property
    def _given(self) -> Silhouettes:
        """As the masks are."""
        return Silhouettes.of(self._rig, self._masks, self._centre, self._radius)

    @cached_property
    def _agreed(self) -> Silhouettes:
        """Without what contradicts the others."""
        return agreed(self._rig, self._masks)

    def _lost(
        self, others: Silhouettes, own: Silhouettes, most: int | None
    ) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """View, origin and directions [N, 3] of foreground rays that the others explain and the `own` silhouette does
        not; of about so many of each view, or of all that are asked."""
        together = others.joined(own)
        for u in others.views:
            origin, directions = foreground_rays(self._rig, u, self._masks[u], most)
            lost = directions[missed(together, u, origin, directions)]
            yield u, origin, lost[~missed(others, u, origin, lost)]


def _place(
    rig: Rig, view: int, masks: Mapping[int, np.ndarray], others: Silhouettes, contradicted: np.ndarray
) -> np.ndarray:
    """[h, w] bool: where something stands before the subject in a view, with what lies between it and the mask, which
    is neither the subject nor known to be beside it. `contradicted` [h, w] uint8: where its mask carves what
    others agree on."""
    place, mask = np.zeros(contradicted.shape, bool), masks[view]
    if not contradicted.any():
        return place
    largest = max(int(foreground(m).sum()) for m in masks.values())
    around = cv2.dilate(contradicted, disc(AROUND)) > 0
    count, labels, stats, _ = cv2.connectedComponentsWithStats(_possible(rig, view, mask, others), connectivity=8)
    for i in range(1, count):
        inside = labels == i
        if stats[i, cv2.CC_STAT_AREA] >= LEAST * largest and around[inside].mean() >= CONTRADICTED:
            place |= inside & around
    return (cv2.dilate(place.astype(np.uint8), disc(AROUND)) > 0) & ~foreground(mask)


def _possible(rig: Rig, view: int, mask: np.ndarray, others: Silhouettes) -> np.ndarray:
    """[h, w] uint8: 1 where the others' hull lies behind the background of a view's mask, without what is thin."""
    width, height = (int(n) for n in rig.size[view])
    rows, columns = np.mgrid[0:height:STRIDE, 0:width:STRIDE]
    background = ~foreground(mask[:height:STRIDE, :width:STRIDE])
    origin, directions = rays(
        points_from_integer_centres(np.stack([columns[background], rows[background]], axis=-1)),
        rig.intrinsics[view],
        rig.world_to_camera[view],
    )
    found = np.zeros(background.shape, np.uint8)
    found[background] = others.ends(origin, directions, (0.0, 0.0), votes=False)[:, 1] > 0
    thick = cv2.morphologyEx(found, cv2.MORPH_OPEN, disc(max(1.0, THIN * max(width, height))))
    out = np.zeros(mask.shape, np.uint8)
    out[:height, :width] = np.repeat(np.repeat(thick, STRIDE, axis=0), STRIDE, axis=1)[:height, :width]
    return out
