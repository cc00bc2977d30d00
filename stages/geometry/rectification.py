"""Rectified pairs: two virtual cameras with parallel axes in which the same point lies on the same row.

After Fusiello, Trucco and Verri, "A compact algorithm for rectification of stereo pairs" (2000): the shared x axis runs
along the baseline, the z axis is what is left of the mean optical axis. Nothing else is asked of the baseline: pictures
are turned until it runs along their rows, however the cameras are held and whichever way the second stands from the
first. The principal points are free: each is chosen so that the subject lies in the middle of its picture, and the
difference of the two is carried as an explicit offset of the disparity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.geometry.subject import up_direction
from posegaussian.storage.model.cameras import Rig, points_to_integer_centres

FRAME_GROWTH = 1.5
"""Side of the rectified frame over the longest side of the two sources: it holds a picture turned by any angle."""
STRETCH = 8.0
"""A source pixel may be drawn out to so many rectified ones; beyond it, 60 degrees off the rectified optical axis,
there is nothing left to compare."""
LEVEL = 1e-6
"""Sine of the angle to the vertical below which a baseline stands upright, so that its sides are left and right."""
Window = tuple[int, int, int, int]
"""x0, y0, width, height of a part of the rectified plane, px; it may reach beyond the frame."""


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """Two rectified cameras; index 0 is the first view of `views`, 1 the second."""

    views: tuple[int, int]
    """Indices of the two views in the rig."""
    rotation: np.ndarray
    """[3, 3] world to rectified axes, shared by both cameras."""
    centres: np.ndarray
    """[2, 3] camera centres in the world, metres."""
    intrinsics: np.ndarray
    """[2, 3, 3] px, our pixel centres: equal focal length and rows, different columns of the principal point."""
    to_source: np.ndarray
    """[2, 3, 3] homographies from homogeneous rectified pixels to source pixels; the third row gives source depth
    per rectified depth."""
    size: tuple[int, int]
    """(width, height) of the rectified frame, px, the subject in its middle."""
    source_size: np.ndarray
    """[2, 2] (width, height) of the source pictures, px."""
    scale: float = 1.0
    """Focal length over the mean focal length of the source views."""
    quarters: int = 0
    """By how many quarters, counter-clockwise, rectified pictures must be turned for the rig's up to point upwards
    rather than to a side: 1 or 3 where the baseline runs more upright than level, else 0."""

    @property
    def focal(self) -> float:
        """Focal length of both rectified cameras, px."""
        return float(self.intrinsics[0, 0, 0])

    @property
    def baseline(self) -> float:
        """Metres along the rectified x axis from the first camera to the second;
        negative when the second lies to the left."""
        return float(self.rotation[0] @ (self.centres[1] - self.centres[0]))

    @property
    def offset(self) -> float:
        """Disparity of a point at infinity, px: the difference of the principal points' columns."""
        return float(self.intrinsics[0, 0, 2] - self.intrinsics[1, 0, 2])

    @property
    def sensitivity(self) -> float:
        """Px of disparity per 1/metre of inverse depth at the sources' own scale: focal * abs(baseline) / scale."""
        return self.focal * abs(self.baseline) / self.scale

    def world_to_camera(self, which: int) -> np.ndarray:
        """[4, 4] of one rectified camera."""
        out = np.eye(4)
        out[:3, :3] = self.rotation
        out[:3, 3] = -self.rotation @ self.centres[which]
        return out

    def disparity(self, depth: np.ndarray) -> np.ndarray:
        """Rectified depth, metres -> x0 - x1 = focal * baseline / depth + offset, px; float64: in float32 an offset
        of 1500 px leaves 1e-4 px."""
        return self.focal * self.baseline / np.asarray(depth, dtype=np.float64) + self.offset

    def depth(self, disparity: np.ndarray) -> np.ndarray:
        """Disparity x0 - x1, px -> rectified depth, metres; infinite or negative where no point in front of the
        cameras has it."""
        with np.errstate(divide="ignore"):
            return self.focal * self.baseline / (np.asarray(disparity, dtype=np.float64) - self.offset)

    def source_pixels(self, which: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rectified pixels [..., 2] -> source pixels [..., 2] and source depth per rectified depth [...].

        Both in our pixel centres. A ratio of at most 0 means that the pixel lies behind the source camera.
        """
        return _apply(self.to_source[which], pixels)

    def rectified_pixels(self, which: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Source pixels [..., 2] -> rectified pixels [..., 2] and rectified depth per source depth [...]."""
        return _apply(np.linalg.inv(self.to_source[which]), pixels)

    def seen(self, which: int, pixels: np.ndarray) -> np.ndarray:
        """[...] bool: which rectified pixels [..., 2] a source picture shows."""
        source, ratio = self.source_pixels(which, pixels)
        width, height = self.source_size[which]
        x, y = source[..., 0], source[..., 1]
        return (ratio > 0) & (x >= 0) & (y >= 0) & (x <= width) & (y <= height)

    def comparable(self, which: int, ratio: np.ndarray) -> np.ndarray:
        """[...] bool: source pixels with that rectified depth per source depth that are drawn out by at most STRETCH.

        The homography H enlarges areas by det H / ratio^3.
        """
        growth = 1 / np.linalg.det(self.to_source[which]) / self.scale**2
        return (ratio > 0) & (growth <= STRETCH * np.maximum(ratio, 0) ** 3)

    def maps(self, which: int, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Maps x, y [h, w] float32 for `cv2.remap`,
        which give a window of the rectified picture from the source picture."""
        x0, y0, w, h = window
        source, _ = self.source_pixels(which, pixel_centres((w, h)) + np.array([x0, y0]))
        x, y = np.moveaxis(points_to_integer_centres(source).astype(np.float32), -1, 0)
        return np.ascontiguousarray(x), np.ascontiguousarray(y)


def _apply(homography: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [..., 2] -> where the homography [3, 3] takes them [..., 2], and the third row's value [...]; float64."""
    from posegaussian.stages.geometry.homography import applied  # plans rectify, and import no compiler

    flat = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 2)
    image, ratio = applied(np.ascontiguousarray(homography), flat)
    return image.reshape(pixels.shape), ratio.reshape(pixels.shape[:-1])


def rectify(
    rig: Rig, first: int, second: int, subject: np.ndarray, scale: float = 1.0, up: np.ndarray | None = None
) -> RectifiedPair:
    """The rectified pair of two views, with the subject [3] (world metres) in the middle of both pictures.

    Whatever way round: rows run so that `up` [3], by default the rig's, is up in the rectified pictures, and where the
    baseline itself is upright, so that it is left. The order of the views changes the sign of the baseline only.

    The focal length is the mean of the two views' times `scale`: above 1 the rectified pictures are finer than the
    sources.

    Raises ValueError where no rectification exists: equal centres, a baseline along the optical axes, or a subject
    behind the pair. Whether the pair is any good for matching is the question of
    `posegaussian.stages.geometry.pairs.classify`.
    """
    pair = [first, second]
    centres, rotations = rig.centres[pair], rig.rotations[pair]
    along = centres[1] - centres[0]
    baseline = np.linalg.norm(along)
    if baseline < 1e-9:
        raise ValueError(
            f"cameras {rig.names[first]} and {rig.names[second]} stand {baseline:g} m apart; a pair needs a baseline"
        )
    x = along / baseline
    forward = rotations[:, 2].sum(axis=0)
    z = forward - (forward @ x) * x
    if np.linalg.norm(z) < 1e-6 * max(1.0, float(np.linalg.norm(forward))):
        raise ValueError(
            f"cameras {rig.names[first]} and {rig.names[second]} have no common side:"
            " their baseline runs along the optical axes"
        )
    z /= np.linalg.norm(z)
    up = up_direction(rig) if up is None else up
    down = float(np.cross(z, x) @ -up)
    x = x if (down if abs(down) > LEVEL else -float(x @ up)) >= 0 else -x
    rotation = np.stack([x, np.cross(z, x), z])
    seen = (subject - centres) @ rotation.T
    if (seen[:, 2] <= 0).any():
        raise ValueError(
            f"the subject {np.round(subject, 3).tolist()} lies behind the rectified cameras of {rig.names[first]} and"
            f" {rig.names[second]}"
        )
    size = int(np.ceil(FRAME_GROWTH * scale * rig.size[pair].max()))
    focal = scale * float(rig.intrinsics[pair][:, [0, 1], [0, 1]].mean())
    intrinsics = np.zeros((2, 3, 3))
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] = focal
    intrinsics[:, 2, 2] = 1.0
    intrinsics[:, 0, 2] = size / 2 - focal * seen[:, 0] / seen[:, 2]
    # Rows of both are equal but for rounding; one value keeps them aligned exactly.
    intrinsics[:, 1, 2] = size / 2 - focal * seen[0, 1] / seen[0, 2]
    to_source = rig.intrinsics[pair] @ rotations @ rotation.T @ np.linalg.inv(intrinsics)
    right, below, _ = rotation @ up
    quarters = 0 if abs(right) <= abs(below) else 1 if right > 0 else 3
    return RectifiedPair(
        (first, second), rotation, centres, intrinsics, to_source, (size, size), rig.size[pair], scale, quarters
    )
