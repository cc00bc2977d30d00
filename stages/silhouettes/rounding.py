"""The hull's surface, made as round as its outline says.

A visual hull of few views has flat sides and corners: it is the largest body that fits the silhouettes, and the subject
lies inside it. At an outline a ray grazes the subject at one point, halfway through the hull where the limb is as round
in front as behind. From there to the touch of the hull's last side, whose camera tells where on the limb that is, the
limb is taken for an ellipse with the outline's width and the hull's depth, and depth is moved back to it. Of four
views, whose hull of a cylinder is a square, the result is the cylinder; of many views hardly anything is moved.
"""

from __future__ import annotations

import cv2
import numpy as np

IN = 0.5
"""Px by which the middle of an outline's pixel lies within the outline."""
APART = 0.2
"""Radians at the limb from an outline to where another camera's side touches it, at least: a camera across the subject
sees the same outline and cuts nothing off beside it."""
THIN = 0.1
"""Radians of a touch so near to the outline that nothing is moved."""
ALONG = 0.3
"""Length of a camera's direction across a limb below which it looks along the limb, and says nothing of its section."""
FLATTEST, DEEPEST = 0.4, 2.0
"""Depth of a limb over its width. Where the hull is shallower, at the end of a limb or the top of a head, something
else has cut it off, too, and it is taken for round; it is never taken for deeper."""


def rounded(near: np.ndarray, far: np.ndarray, focal: float, others: np.ndarray) -> np.ndarray:
    """Depth [h, w] float32 m of the subject, from the hull's `near` and `far` end [h, w] m along each ray of a picture
    with this focal length, px; 0 where there is none.

    others: [K, 3] directions from the subject to the other cameras that carve, in the camera's axes (x right, y down, z
    ahead).

    An outline is where the hull ends in the picture, or where what is beside it begins behind its far end; the
    picture's edge, which cuts the subject off, is none.
    """
    inside = near > 0
    outwards = _outwards(near, far)
    rim = inside & (np.abs(outwards).sum(axis=-1) > 0)
    if not rim.any():
        return near
    to_rim, nearest = cv2.distanceTransformWithLabels(
        np.where(rim, 0, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    from_outline = np.where(inside, to_rim + IN, 0).astype(np.float32)
    radius = np.maximum(np.maximum(_half_width(from_outline), from_outline), 2 * IN)
    limb = radius * np.where(inside, near, 0) / focal  # metres
    touch, deep = np.ones(nearest.max() + 1, np.float32), np.zeros(nearest.max() + 1, np.float32)
    touch[nearest[rim]], deep[nearest[rim]] = _last_side(
        _evened(outwards, rim)[rim], (far - near)[rim] / 2 / limb[rim], others
    )
    angle, depth = np.maximum(_evened(touch[nearest], inside), THIN), _evened(deep[nearest], inside)
    across = np.where(inside, 1 - from_outline / radius, 0)
    reach = np.hypot(np.cos(angle), depth * np.sin(angle))
    side = (reach - across * np.cos(angle)) / np.sin(angle)
    back = np.where(across * reach > np.cos(angle), side - depth * np.sqrt(1 - across**2), 0) * limb
    return np.where(inside, np.clip(near + back, near, (near + far) / 2), 0).astype(np.float32)


def _last_side(outwards: np.ndarray, half: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of R pixels of an outline: radians from it to where the hull's last side touches a round limb of that width, up
    to pi/2, and the limb's depth over its width.

    outwards: [R, 2] directions in the picture. half: [R] half the hull's part of the ray over half the limb's width.
    A camera at an angle f from this one, counted towards the outline, touches a circle at a = -f (modulo pi) from the
    outline; its side meets the outline's ray, of an ellipse b times as deep as wide, at half = sqrt(cot^2 a + b^2) -
    cot a before the middle. Of the cameras by which b is not too large the last side is that of the least a; without
    any the limb is round from one outline to the other.
    """
    lengths = np.maximum(np.linalg.norm(outwards, axis=1), 1e-6)
    towards, across = -others[:, 2], (outwards / lengths[:, None]) @ others[:, :2].T  # [K], [R, K]
    angles = np.mod(-np.arctan2(across, towards), np.pi)
    angles = np.where((angles > APART) & (np.hypot(across, towards) > ALONG), angles, np.pi / 2)
    angles = np.minimum(angles, np.pi / 2)
    angles = np.where(_depth_of(half[:, None], angles) <= DEEPEST, angles, np.pi / 2).min(axis=1, initial=np.pi / 2)
    flat = _depth_of(half, angles) < FLATTEST
    angles = np.where(flat, np.clip(2 * np.arctan(half), THIN, np.pi / 2), angles)
    return angles, np.minimum(_depth_of(half, angles), DEEPEST)


def _depth_of(half: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """An ellipse's depth over its width, from where its last side meets the outline's ray and touches a circle."""
    return np.asarray(np.sqrt(half**2 + 2 * half / np.tan(angles)))


def _outwards(near: np.ndarray, far: np.ndarray) -> np.ndarray:
    """[h, w, 2] (x, y): where the four neighbours lie that are outside the hull, or behind the pixel's far end, added
    up; 0 where there is none."""
    behind = np.pad(np.where(near > 0, near, np.inf), 1, mode="edge")
    left, right, above, below = (
        (side > far).astype(np.float32)
        for side in (behind[1:-1, :-2], behind[1:-1, 2:], behind[:-2, 1:-1], behind[2:, 1:-1])
    )
    return np.stack([right - left, below - above], axis=-1)


def _evened(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """[h, w] or [h, w, n] means over the `known` pixels [h, w] bool of 5 x 5: neighbours may belong to unlike points of
    the outline, whose steps are those of the pixels."""
    shares = np.maximum(cv2.blur(known.astype(np.float32), (5, 5)), 1e-6)
    mask = known if values.ndim == 2 else known[..., None]
    sums = cv2.blur(np.where(mask, values, 0).astype(np.float32), (5, 5))
    return sums / (shares if values.ndim == 2 else shares[..., None])


def _half_width(to_rim: np.ndarray) -> np.ndarray:
    """[h, w] px radius of the largest disc inside the outline that holds a pixel, from its distance to it [h, w].

    Discs are drawn a little larger, for these distances err by some percent and outlines are not round.
    """
    ridge = (to_rim > 0) & (to_rim >= cv2.dilate(to_rim, np.ones((3, 3), np.uint8)) - 0.5)
    rows, columns = np.nonzero(ridge)
    radii, out = to_rim[rows, columns], np.zeros_like(to_rim)
    for i in np.argsort(radii, kind="stable"):
        cv2.circle(out, (int(columns[i]), int(rows[i])), int(1.05 * radii[i]) + 2, float(radii[i]), thickness=-1)
    return out
