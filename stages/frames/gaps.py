"""Gaps that given masks fill, between arm and trunk or between the legs: what lies inside a mask beside the body and
looks like the backdrop around it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posegaussian.stages.frames.bodies.body import body_shape, pixels_per_metre
from posegaussian.stages.imaging.part import part_around
from posegaussian.storage.model.cameras import points_to_integer_centres
from posegaussian.storage.model.masks import foreground

THIN = 0.5
"""Thickness of limbs, over that of a body's, within which a pixel is the body's, and cannot be a gap."""
SURE = 0.02
"""Metres within that from which on it is the body's for certain: joints err by a centimetre or two."""
AROUND, ALONG = 0.25, 0.12
"""Metres around a pixel in which the backdrop's colours are learnt, outside of the mask, and the person's, on the thin
body."""
RIM = 0.012
"""Metres beside a mask's outline that teach nothing: hair, blur, and masks that are too narrow."""
FEWEST = 30
"""Pixels whose colours a pixel is compared with at least."""
NOISE = 2.5
"""Of a picture, 1/255, which a backdrop of one colour has, too."""
LIKE = 12.0
"""Squared distance from the backdrop's colours, in their own spread, up to which a pixel looks like them: 0.7 % of the
backdrop's own lie farther."""
CLEARLY = 4.0
"""By how much the backdrop must be likelier than the person, twice the logarithm."""
SMALLEST = 0.02
"""Metres along a side of the smallest gap."""
BLUR = 0.7
"""Px by which pictures are blurred before they are compared, and the outlines of gaps are soft."""


@dataclass(frozen=True, eq=False)
class Gaps:
    """What a mask fills."""

    where: np.ndarray
    """[h, w] bool."""
    share: float
    """Of the mask that they are."""
    doubt: float
    """Share of what is the body's for certain that looks like the backdrop, too: clothes of its colour."""


def gaps_in(picture: np.ndarray, mask: np.ndarray, people: np.ndarray, set_id: str) -> Gaps | None:
    """Gaps of a mask [h, w] uint8 in its picture [h, w, 3] uint8 sRGB; None where no joints tell where its body is.

    people [n, J, 3] (u, v, score) px, our pixel centres; those who stand outside of the mask do not count. The colours
    of both are normal distributions, each in a window around the pixel: of the backdrop by what lies outside of the
    mask, of the person by what lies on the bones.
    """
    inside = foreground(mask)
    inner = [joints for joints in people if _stands_in(joints, inside)]
    scale = max((pixels_per_metre(joints, set_id) for joints in inner), default=0.0)
    if scale <= 0:
        return None
    part = part_around(inside, round(AROUND * scale))
    where, inside = np.zeros(mask.shape, bool), inside[part]
    body = np.zeros(mask.shape, bool)
    for joints in inner:
        body |= body_shape(joints, set_id, (mask.shape[1], mask.shape[0]), THIN * pixels_per_metre(joints, set_id))
    body = body[part] & inside
    like = _like_the_backdrop(picture[part], inside, body, scale)
    sure = cv2.erode(body.astype(np.uint8), _disc(SURE * scale)) > 0
    where[part] = _large(like & ~body, (SMALLEST * scale) ** 2)
    share, doubt = (float(a.sum() / max(b.sum(), 1)) for a, b in ((where, inside), (like & sure, sure)))
    return Gaps(where, share, doubt)


def opened(mask: np.ndarray, gaps: np.ndarray) -> np.ndarray:
    """A mask [h, w] uint8 without some gaps [h, w] bool, their outlines as soft as a picture's edges.

    A gap is found up to where its colours mix with the person's, and reaches half a pixel farther.
    """
    wide = cv2.dilate(gaps.astype(np.float32), np.ones((3, 3), np.uint8))
    kept = 1 - cv2.GaussianBlur(wide, (0, 0), BLUR)
    return np.rint(mask * kept).astype(np.uint8)


def _stands_in(joints: np.ndarray, inside: np.ndarray) -> bool:
    """Whether most of a person's known joints [J, 3] lie in a mask [h, w] bool."""
    height, width = inside.shape
    at = np.rint(points_to_integer_centres(joints[joints[:, 2] > 0, :2])).astype(int)
    within = at[((at >= 0) & (at < [width, height])).all(axis=1)]
    return bool(len(at)) and inside[within[:, 1], within[:, 0]].sum() > len(at) / 2


def _like_the_backdrop(picture: np.ndarray, inside: np.ndarray, body: np.ndarray, scale: float) -> np.ndarray:
    """[h, w] bool: pixels inside whose colours are the backdrop's, and clearly not those of the person beside them."""
    colors = cv2.GaussianBlur(picture, (0, 0), BLUR).astype(np.float32) - 128  # about 0: squares stay small
    outside = cv2.dilate(inside.astype(np.uint8), _disc(RIM * scale)) == 0
    rows, columns = np.nonzero(inside)
    (there, far, spread), (here, near, own) = (
        _distances(colors, of, (rows, columns), round(window * scale))
        for of, window in ((outside, AROUND), (body, ALONG))
    )
    clearly = far + spread < near + own - CLEARLY
    out = np.zeros(inside.shape, bool)
    out[rows, columns] = (there >= FEWEST) & (far < LIKE) & (clearly | (here < FEWEST))
    return out


def _distances(
    colors: np.ndarray, of: np.ndarray, at: tuple[np.ndarray, np.ndarray], around: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the pixels `at`: how many pixels `of` [h, w] bool lie around, the squared Mahalanobis distance of the pixel's
    colour [h, w, 3] from theirs, and the logarithm of the determinant of their covariance."""
    weight = of.astype(np.float32)

    def mean_of(values: np.ndarray) -> np.ndarray:
        side = 2 * around + 1
        summed = cv2.boxFilter(values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(summed[at], np.float64)

    count = mean_of(weight)
    total = np.maximum(count, 1)
    mean = np.stack([mean_of(weight * colors[..., c]) for c in range(3)], axis=-1) / total[:, None]
    covariance = np.empty((len(count), 3, 3))
    for a in range(3):
        for b in range(a, 3):
            product = mean_of(weight * colors[..., a] * colors[..., b]) / total - mean[:, a] * mean[:, b]
            covariance[:, a, b] = covariance[:, b, a] = product
    covariance += NOISE**2 * np.eye(3)
    apart = colors[at] - mean
    far = np.einsum("ni,ni->n", apart, np.linalg.solve(covariance, apart[..., None])[..., 0])
    return count, far, np.linalg.slogdet(covariance)[1]


def _large(where: np.ndarray, area: float) -> np.ndarray:
    """[h, w] bool without specks: what is less than three px wide, or smaller than an area in square px."""
    whole = cv2.morphologyEx(where.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(whole, connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= area
    large[0] = False
    return np.asarray(large[labels])


def _disc(radius: float) -> np.ndarray:
    side = 2 * max(1, round(radius)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
