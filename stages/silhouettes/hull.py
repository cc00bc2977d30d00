"""The visual hull seen from one view: the nearest and the farthest point of every pixel's ray that all masks allow.

Image-based: no voxels. For each foreground pixel the ray is first clipped, exactly, to the boxes around the other
views' masks, then walked in steps of about one pixel of motion in the other views, or farther where a silhouette is
farther away; both ends are refined by bisection (Matusik et al., "Image-based visual hulls", 2000, find the same
intervals on the epipolar lines).

A view carves only what it can see: a point beside its picture or behind its camera stays, and a view whose mask is
empty says nothing. A point that fewer than two other views see (or the only other one) is not part of the hull, because
too little speaks for it: the opposite camera of a ring sees a ray from end to end and carves none of it. Nor is a part
of a ray that less than a third of the views to its side see, of those that see it by the subject's middle.

A ray without a hull is tried again: with silhouettes a little wider, for masks and calibrations that are off, then
against the vote of one view, whose mask may lack a limb. Masks that are wrong as a whole are found by
`posegaussian.stages.silhouettes.agreement`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from posegaussian.stages.geometry.pairs import ALONG
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.silhouettes.distance import box, distance_to_foreground, within
from posegaussian.stages.silhouettes.march import MOST_POINTS, march, meets
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres, to_integer_centres
from posegaussian.storage.model.masks import foreground

REACH, CLOSE = 0.9, 0.7
"""Radius of the searched sphere over the distance of the nearest camera, so that it holds none; but one nearer than the
second share of the median distance is taken to be as far: a close-up does not say where people may walk."""
TOLERANCE = (0.0, 1.5)
"""Px a point may lie outside another view's silhouette; the second value only for rays without a hull at the first."""
OUTVOTED = 4
"""Other views, at least, of which one may be overruled for a ray that has no hull otherwise."""
NEAR_SIDE, FAR_SIDE = np.cos(np.deg2rad(ALONG))
"""Cosines at the subject's middle between a ray's origin and cameras on its own side and on its other one, which look
along the ray."""
OBLIQUE = 1.5
"""Px by which a point moves for a metre sideways, over focal length / depth, at most: 48 degrees off the axis."""


def searched_radius(rig: Rig, views: list[int], centre: np.ndarray) -> float:
    """Metres: radius of the sphere around `centre` [3] in which the subject of these views is searched."""
    apart = np.linalg.norm(rig.centres[views] - centre, axis=1)
    return REACH * float(max(apart.min(), CLOSE * np.median(apart)))


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """What S views say about where the subject is, prepared once for rays from anywhere."""

    views: tuple[int, ...]
    """S views with some foreground."""
    distance: np.ndarray
    """[S, h, w] float32: px outside the silhouette, see `distance_to_foreground`."""
    projections: np.ndarray
    """[S, 3, 4] world metres to homogeneous px, integer centres."""
    boxes: np.ndarray
    """[S, 4] x0, y0, x1, y1 in integer-centre px: the part of a picture outside which it carves everything it sees."""
    sizes: np.ndarray
    """[S, 2] (width, height) px."""
    focals: np.ndarray
    """[S] px by which a point moves for a metre sideways at a metre of depth, at most."""
    pixels: np.ndarray
    """[S] metres of a px at the centre."""
    centre: np.ndarray
    """[3] middle of what is searched, world metres."""
    radius: float
    """Metres around it that are searched."""

    @classmethod
    def of(
        cls,
        rig: Rig,
        masks: Mapping[int, np.ndarray],
        centre: np.ndarray,
        radius: float,
        tolerance: float = TOLERANCE[1],
    ) -> Silhouettes:
        """Of masks [h, w] uint8 by view index; the pictures lie at the top left of the arrays and `rig.size` says how
        large they are.

        `tolerance`: px beyond a silhouette that will be asked for, at most.
        """
        views = [v for v in sorted(masks) if foreground(masks[v][: rig.size[v, 1], : rig.size[v, 0]]).any()]
        shape = next((m.shape for m in masks.values()), (0, 0))
        distance = (
            np.stack([distance_to_foreground(masks[v], rig.size[v]) for v in views])
            if views
            else np.zeros((0, *shape), np.float32)
        )
        boxes = np.array([box(masks[v], rig.size[v], tolerance) for v in views]).reshape(-1, 4)
        pixels = np.linalg.norm(rig.centres[views] - centre, axis=1) / rig.intrinsics[views, 0, 0]
        projections = to_integer_centres(rig.intrinsics[views]) @ rig.world_to_camera[views, :3]
        return cls(
            tuple(views),
            distance,
            projections,
            boxes,
            rig.size[views].astype(np.float64),
            OBLIQUE * rig.intrinsics[views][:, [0, 1], [0, 1]].max(axis=1, initial=0),
            pixels,
            centre,
            radius,
        )

    @property
    def pixel(self) -> float:
        """Metres from one point of a ray to the next: a px at the centre of the sharpest view, or more where the
        sphere would take more than `MOST_POINTS`."""
        return self._pixel_among(np.arange(len(self.views)))

    def _pixel_among(self, among: np.ndarray) -> float:
        """The same of those of some views alone."""
        return max(float(self.pixels[among].min()), 2 * self.radius / MOST_POINTS)

    def asked(self, origin: np.ndarray, without: int | None = None) -> tuple[np.ndarray, int]:
        """Indices of the silhouettes but that of a view, whether it has one or not, those first that look from the side
        at rays from `origin` [3], and how many these are; where all look along them, all count as such."""
        places = -np.linalg.solve(self.projections[:, :, :3], self.projections[:, :, 3:])[..., 0] - self.centre
        towards = origin - self.centre
        cosines = places @ towards / np.maximum(np.linalg.norm(places, axis=1) * np.linalg.norm(towards), 1e-12)
        others = [i for i, v in enumerate(self.views) if v != without]
        sides = [i for i in others if FAR_SIDE < cosines[i] < NEAR_SIDE] or others
        return np.array([*sides, *(i for i in others if i not in sides)], np.int64), len(sides)

    @cached_property
    def whole(self) -> np.ndarray:
        """[S, h, w] float32: px by which a pixel lies, at least, within the part of a mask that carves nothing off it;
        beside it, as far as it lies outside the silhouette, negative."""
        return within(self.distance)

    def wider(self, px: float | np.ndarray) -> Silhouettes:
        """The same, each wider by some px of its own picture, of all or of each [S]."""
        each = np.broadcast_to(px, len(self.views))
        low, high = self.boxes[:, :2] - each[:, None], self.boxes[:, 2:] + each[:, None]
        boxes = np.concatenate([np.maximum(low, 0), np.minimum(high, self.sizes - 1)], axis=1)
        return replace(self, distance=self.distance - each.astype(np.float32)[:, None, None], boxes=boxes)

    def kept(self, views: set[int]) -> Silhouettes:
        """Those of the given views alone."""
        chosen = [i for i, v in enumerate(self.views) if v in views]
        parts: dict[str, Any] = {
            n: np.ascontiguousarray(getattr(self, n)[chosen])
            for n in ("distance", "projections", "boxes", "sizes", "focals", "pixels")
        }
        return replace(self, views=tuple(self.views[i] for i in chosen), **parts)

    def joined(self, other: Silhouettes) -> Silhouettes:
        """These and those of other views, prepared around the same centre."""
        parts: dict[str, Any] = {
            n: np.concatenate([getattr(self, n), getattr(other, n)])
            for n in ("distance", "projections", "boxes", "sizes", "focals", "pixels")
        }
        return replace(self, views=(*self.views, *other.views), **parts)

    def ends(
        self,
        origin: np.ndarray,
        directions: np.ndarray,
        tolerance: tuple[float, float] = TOLERANCE,
        votes: bool = True,
        without: int | None = None,
    ) -> np.ndarray:
        """[N, 2] depth at which rays origin [3] + depth * directions [N, 3] enter and leave the hull, 0 where they miss
        it.

        Rays that miss it are tried again with the second tolerance, px, then, with `votes`, against one view. The hull
        is that of the views but the one `without` which it is asked for.
        """
        tries = [(t, 0) for t in dict.fromkeys(tolerance)]
        if votes and len(self.views) - (without in self.views) >= OUTVOTED:
            tries.append((tolerance[1], 1))
        return self._marched(origin, directions, tries, without)

    def _marched(
        self, origin: np.ndarray, directions: np.ndarray, tries: list[tuple[float, int]], without: int | None
    ) -> np.ndarray:
        """[N, 2] as `march` finds it."""
        out, (among, sides) = np.zeros((len(directions), 2)), self.asked(origin, without)
        if len(among) and len(directions):
            march(
                origin,
                directions,
                self.distance,
                self.projections,
                self.boxes,
                self.sizes,
                self.centre,
                self.radius,
                self._pixel_among(among),
                tries,
                among,
                sides,
                out,
            )
        return out

    def met(self, origin: np.ndarray, directions: np.ndarray, tolerance: float, without: int | None) -> np.ndarray:
        """[N] bool: which rays origin [3] + depth * directions [N, 3] the hull of the views but one leaves something
        of; `tolerance` px beyond the silhouettes."""
        out, (among, sides) = np.zeros(len(directions), bool), self.asked(origin, without)
        if len(among) and len(directions):
            meets(
                origin,
                directions,
                self.distance,
                self.projections,
                self.boxes,
                self.sizes,
                self.centre,
                self.radius,
                self._pixel_among(among),
                tolerance,
                among,
                sides,
                out,
            )
        return out


def visual_hull(
    rig: Rig,
    view: int,
    mask: np.ndarray,
    silhouettes: Silhouettes,
    tolerance: tuple[float, float] = TOLERANCE,
    votes: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Near and far depth [h, w] float32 of the hull along each foreground ray of `view`, metres along its optical axis.

    `mask` [h, w] uint8 is the view's own; `silhouettes` may hold the view itself, which cannot carve its own rays.
    `tolerance` in px lets a point lie that far outside another view's silhouette; rays that miss the hull are tried
    again with the second value, then, with `votes`, against one view, so that errors of calibration and matting do not
    eat limbs. Both maps are 0 where the pixel is background and where no point of its ray is in the hull.
    """
    own = foreground(mask)
    near, far = np.zeros(own.shape, np.float32), np.zeros(own.shape, np.float32)
    rows, columns = np.nonzero(own)
    origin, directions = rays(
        points_from_integer_centres(np.stack([columns, rows], axis=-1)), rig.intrinsics[view], rig.world_to_camera[view]
    )
    near[rows, columns], far[rows, columns] = silhouettes.ends(origin, directions, tolerance, votes, without=view).T
    return near, far
