"""One view's way from captured pixels to `frames/*` pixels, prepared once and applied to every frame."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.imaging.camera_mapping import captured_positions, unreduced_size
from posegaussian.storage.model.cameras import Rig, points_to_integer_centres
from posegaussian.storage.model.errors import SourceError

SAME_SURFACE = 0.02
"""Share by which depths of neighbouring pixels of a depth map may differ, over the nearest of them, and still be of
one surface: 5 cm at 2.5 m."""
STRIP = 128
"""Rows whose map is made at once: in double precision a whole one would take ten times the picture's memory."""


class Warp:
    """Captured picture -> frames picture of one view: undistorted and cropped if called for, then averaged down.

    The geometry is `captured_positions`. Sampling is bilinear at calibrated resolution and only where crop or
    distortion move pixels; reduction is area averaging, so a picture that needs neither comes back byte for byte.
    """

    def __init__(self, view: int, captured: tuple[int, int], source_rig: Rig, rig: Rig, crop: np.ndarray) -> None:
        """Prepare view `view` of captured (width, height) px; crop [3] (scale, dx, dy)."""
        self.view, self.name = view, source_rig.names[view]
        self.captured = (int(captured[0]), int(captured[1]))
        self.size = (int(rig.size[view, 0]), int(rig.size[view, 1]))
        self._unreduced, self._unreduced_size = _unreduced(rig.subset([view]), source_rig.subset([view]))
        moved = self.captured != self._unreduced_size or bool(np.any(crop != [1.0, 0.0, 0.0]))
        self._cameras = (rig.intrinsics[view], source_rig.intrinsics[view], source_rig.distortion[view], crop)
        # A captured picture larger than the calibrated one is averaged down first: bilinear sampling would alias.
        self._reduced = tuple(max(1, round(n * min(1.0, float(crop[0])))) for n in self.captured)
        self._map: tuple[np.ndarray, np.ndarray] | None = None
        coverage = np.full(self._unreduced_size[::-1], 255, dtype=np.uint8)
        if moved or np.any(source_rig.distortion[view]):
            x, y = np.empty(coverage.shape, dtype=np.float32), np.empty(coverage.shape, dtype=np.float32)
            self._map = (x, y)
            for top in range(0, len(coverage), STRIP):
                rows = slice(top, min(top + STRIP, len(coverage)))
                x[rows], y[rows], coverage[rows] = self._sampled(rows)
        self._inside = coverage
        self.coverage = self._reduce(coverage)
        """[h, w] uint8 frames pixels: 255 where the captured picture reaches, 0 outside."""

    def _sampled(self, rows: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Maps x, y for cv2.remap and coverage, each [n, w], of some rows of the picture before it is
        averaged down."""
        pixels = pixel_centres((self._unreduced_size[0], rows.stop - rows.start)) + np.array([0.0, rows.start])
        positions = captured_positions(pixels, self._unreduced, *self._cameras[1:])
        inside = np.all((positions >= 0) & (positions <= self.captured), axis=-1)
        scaled = points_to_integer_centres(positions * (np.array(self._reduced) / self.captured))
        scaled = np.where(inside[..., None], scaled, -1e4)
        return scaled[..., 0], scaled[..., 1], np.where(inside, 255, 0)

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """Captured [h, w] or [h, w, 3] uint8 -> frames pixels; black (0) where the captured picture does not reach.

        Raises SourceError for a picture of another size than the view's.
        """
        if picture.shape[:2] != self.captured[::-1]:
            raise SourceError(
                f"camera {self.name}: a picture of {picture.shape[1]}x{picture.shape[0]} px among pictures of"
                f" {self.captured[0]}x{self.captured[1]} px"
            )
        if self._map is not None:
            if self._reduced != self.captured:
                picture = cv2.resize(picture, self._reduced, interpolation=cv2.INTER_AREA)
            picture = cv2.remap(picture, *self._map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            picture[self._inside == 0] = 0
        return self._reduce(picture)

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """Captured [h, w] -> frames pixels without mixing values:
        each takes the captured pixel its centre falls into."""
        index, inside = self._nearest
        return np.where(inside, values[index[..., 1], index[..., 0]], values.dtype.type(0))

    def depth(self, values: np.ndarray) -> np.ndarray:
        """Depth map [h, w] float32 m of any resolution that shows the captured picture's field -> frames pixels,
        surfaces never mixed.

        Where the four map pixels around a pixel's centre are of one surface (SAME_SURFACE) it is interpolated in
        inverse depth, which is linear on planes; elsewhere it is the nearest one's. 0 where the map holds 0, and
        outside the captured picture.
        """
        height, width = values.shape
        out = np.zeros(self.size[::-1], np.float32)
        for top in range(0, self.size[1], STRIP):
            rows = slice(top, min(top + STRIP, self.size[1]))
            positions, inside = self._captured[0][rows], self._captured[1][rows]
            out[rows] = np.where(
                inside,
                _sampled(values, points_to_integer_centres(positions * (np.array([width, height]) / self.captured))),
                0,
            )
        return out

    @cached_property
    def _captured(self) -> tuple[np.ndarray, np.ndarray]:
        """Captured position [h, w, 2] of every frames pixel's centre, 0 where there is none, and whether there is
        one [h, w]."""
        positions = captured_positions(pixel_centres(self.size), *self._cameras)
        inside = np.all((positions >= 0) & (positions <= self.captured), axis=-1)
        return np.where(inside[..., None], positions, 0.0), inside

    @cached_property
    def _nearest(self) -> tuple[np.ndarray, np.ndarray]:
        positions, inside = self._captured
        index = positions.astype(np.int64)
        return np.minimum(index, np.array(self.captured) - 1), inside

    def _reduce(self, picture: np.ndarray) -> np.ndarray:
        if self.size == self._unreduced_size:
            return picture
        return cv2.resize(picture, self.size, interpolation=cv2.INTER_AREA)


def _unreduced(rig: Rig, source_rig: Rig) -> tuple[np.ndarray, tuple[int, int]]:
    """Intrinsics [3, 3] and (width, height) px of the picture of a single camera at the calibrated resolution, without
    lens and not yet averaged down: the calibrated ones, its sides moved out by whole pixels."""
    size = unreduced_size(rig, source_rig)[0]
    k = source_rig.intrinsics[0].copy()
    k[:2, 2] += np.rint(rig.intrinsics[0, :2, 2] * (size / rig.size[0]) - k[:2, 2])
    return k, (int(size[0]), int(size[1]))


def _sampled(depth: np.ndarray, at: np.ndarray) -> np.ndarray:
    """[...] depth [h, w] at positions [..., 2] in integer-centre px: bilinear in inverse depth on one surface, else
    the nearest pixel's."""
    last = np.array(depth.shape[::-1]) - 1
    at = np.clip(at, 0, last)
    low = np.minimum(at.astype(np.int64), np.maximum(last - 1, 0))
    high, share = np.minimum(low + 1, last), at - low
    four = np.stack([depth[v[..., 1], u[..., 0]] for v in (low, high) for u in (low, high)]).astype(np.float64)
    weights = np.stack(
        [
            (1 - share[..., 1]) * (1 - share[..., 0]),
            (1 - share[..., 1]) * share[..., 0],
            share[..., 1] * (1 - share[..., 0]),
            share[..., 1] * share[..., 0],
        ]
    )
    nearest = np.take_along_axis(four, weights.argmax(axis=0)[None], axis=0)[0]
    one = (four.min(axis=0) > 0) & (four.max(axis=0) <= (1 + SAME_SURFACE) * four.min(axis=0))
    return np.where(one, 1 / (weights / np.where(one, four, 1.0)).sum(axis=0), nearest)
