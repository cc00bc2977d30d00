"""Regions of interest: rotated squares of a picture, the crops taken of them, and points carried to and fro.

A region is (centre u, centre v, side, angle), px and rad, in pictures whose top-left pixel is centred at (0.5, 0.5).
Its own coordinates run from (0, 0) to (1, 1); a positive angle turns its upright clockwise as seen in the picture:
`picture = centre + side R(angle) (own - 1/2)` with R = [[cos, -sin], [sin, cos]] on (right, down).
"""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.storage.model.cameras import points_from_integer_centres, points_to_integer_centres

MARGIN = 1.25
"""Side of a region over twice the radius of the circle around the body:
the margin the landmark model was trained with."""


def own_to_picture(region: np.ndarray) -> np.ndarray:
    """[..., 2, 3] affine from a region's own coordinates to px, for regions [..., 4]."""
    r = np.asarray(region, dtype=np.float64)
    u, v, side, angle = np.moveaxis(r, -1, 0)
    c, s = side * np.cos(angle), side * np.sin(angle)
    return np.stack([np.stack([c, -s, u - (c - s) / 2], -1), np.stack([s, c, v - (s + c) / 2], -1)], -2)


def to_picture(points: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Points [N, 2] in a region's own coordinates (0..1) -> px of the picture, for one region [4]."""
    m = own_to_picture(region)
    return np.asarray(points, dtype=np.float64) @ m[:, :2].T + m[:, 2]


def to_own(points: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Points [N, 2] px of the picture -> a region's own coordinates (0..1), the inverse of `to_picture`."""
    m = own_to_picture(region)
    return (np.asarray(points, dtype=np.float64) - m[:, 2]) @ np.linalg.inv(m[:, :2]).T


def region_of(centre: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """[4] region of a body from its centre and a point on the circle around it, above the head: px [2] each.

    The side is 2 x 1.25 x their distance, a pixel at least, and the region's upright points from the centre to the rim.
    """
    du, dv = (np.asarray(rim, dtype=np.float64) - centre).tolist()
    return np.array([centre[0], centre[1], max(2 * MARGIN * np.hypot(du, dv), 1.0), np.arctan2(du, -dv)])


def around(box: np.ndarray) -> np.ndarray:
    """[4] upright region around a box (u0, v0, u1, v1), px:
    its longer side with the margin that a body's region has."""
    u0, v0, u1, v1 = np.asarray(box, dtype=np.float64).tolist()
    return np.array([(u0 + u1) / 2, (v0 + v1) / 2, MARGIN * max(u1 - u0, v1 - v0), 0.0])


def whole(size: tuple[int, int]) -> np.ndarray:
    """[4] the smallest square around a picture of size (width, height): with it a crop is a letterbox."""
    return np.array([size[0] / 2, size[1] / 2, max(size), 0.0])


def squares(size: tuple[int, int], share: float = 1.0) -> np.ndarray:
    """[N, 4] squares of `share` of the short side, overlapping by a half or more, that cover a picture of size (width,
    height).

    None where that would be one square, or the picture is at most 1.2 times as long as it: the whole picture shows
    people nearly as large.
    """
    side = min(size) * share
    if max(size) <= 1.2 * side:
        return np.zeros((0, 4))
    u, v = (np.linspace(side / 2, n - side / 2, 1 + int(np.ceil((n - side) / (side / 2)))) for n in size)
    return np.array([(x, y, side, 0.0) for y in v for x in u])


def crop_to_own(shares: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Points [..., 2] in shares 0..1 of a crop that is `share` (across, down) of its region's side, about the centre
    -> the region's own coordinates."""
    return 0.5 + share * (shares - 0.5)


def own_to_crop(own: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The inverse of `crop_to_own`."""
    return (own - 0.5) / share + 0.5


def crop(
    picture: np.ndarray,
    region: np.ndarray,
    size: tuple[int, int],
    border: int = cv2.BORDER_CONSTANT,
    share: np.ndarray | None = None,
) -> np.ndarray:
    """[height, width, 3] the region of a picture [h, w, 3] uint8, sampled bilinearly; `size` is (width, height) in
    cells.

    The centre of the crop's cell (i, j) lies at ((j + .5)/width, (i + .5)/height) of the region, or of the part of it
    that `share` names (see `crop_to_own`). A picture more than twice as fine as the crop is averaged over whole pixels
    first, so that nothing aliases. Outside is black, or as OpenCV's `border` says.
    """
    share = np.ones(2) if share is None else share
    h, w = picture.shape[:2]
    shrink = int((region[2] * share / size).min())
    scale = np.ones(2)
    if shrink >= 2:
        small = (max(1, round(w / shrink)), max(1, round(h / shrink)))
        picture, scale = cv2.resize(picture, small, interpolation=cv2.INTER_AREA), np.array(small) / (w, h)
    cells = crop_to_own(points_from_integer_centres(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])) / size, share)
    origin, right, down = points_to_integer_centres(to_picture(cells, region) * scale)
    affine = np.stack([right - origin, down - origin, origin], axis=1)
    return cv2.warpAffine(picture, affine, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=border)
