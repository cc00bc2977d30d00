"""Where the subject stands, as far as the cameras alone can tell."""

from __future__ import annotations

import numpy as np

from posegaussian.storage.model.cameras import Rig

STATURE = 1.7
"""Metres; a standing grown person, what the extent of a silhouette is taken for."""
TALL_STATURE = 1.8
"""Metres; a tall grown person, whom a capture's framing and the cameras' common view must hold."""
PERSON_RADIUS = 0.3
"""Metres; half the width of a person with the arms down."""
FILLED = 0.75
"""Share of the picture's longer side a person fills in a capture framed on purpose."""
UPRIGHT = 0.94
"""Length of the mean upward axis, over the longest mean axis of any common roll, down to which cameras pass as upright.
Cameras above each other over 60 degrees have 0.95; an arc of 90 degrees whose pictures lie on their side has 0.90."""
ALIKE = 0.7
"""Length of the mean roll (a point of the unit circle for each camera) below which each is rolled in its own way."""
LEVEL, STEEP = np.sin(np.radians([15.0, 35.0]))
"""Sines of the angles above or below level up to which a camera's optical axis counts in full as level, and from which
on it does not count: how steeply a camera looks is anybody's choice, but its pictures' lower edges lie level."""
PULL = 0.03
"""Weight beside a camera's of the upward picture axes' own mean, which decides where all lower edges are parallel."""
SURE = 0.05
"""Sine of the angle by which a camera must look up or down for that to tell above from below."""


def expected_distance(rig: Rig) -> np.ndarray:
    """[V] metres along the optical axis at which a person fills three quarters of each camera's longer side."""
    focal = rig.intrinsics[:, [0, 1], [0, 1]].mean(axis=1)
    return focal * TALL_STATURE / (FILLED * rig.size.max(axis=1))


def middle_rays(rig: Rig) -> np.ndarray:
    """[V, 3] directions in the world through the middle of every picture, a metre along the optical axis; no lens.

    Where a camera looks: a picture that was cut far beside the principal point has its subject in its middle all the
    same, not on the optical axis.
    """
    middle = np.concatenate([rig.size / 2, np.ones((len(rig), 1))], axis=1)
    return np.einsum("vji,vj->vi", rig.rotations, np.linalg.solve(rig.intrinsics, middle[..., None])[..., 0])


def look_at_point(rig: Rig) -> np.ndarray:
    """[3] the world point nearest to the rays through the middle of all pictures, metres.

    Least squares over these rays with a pull (weight 1e-4) towards their points at `expected_distance`, which decides
    where they are parallel. When the result lies behind a camera the mean of those points is taken instead.
    """
    rays, centres = middle_rays(rig), rig.centres
    expected = (centres + rays * expected_distance(rig)[:, None]).mean(axis=0)
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - along[:, :, None] * along[:, None, :]
    weight = 1e-4 * len(rig)
    point = np.linalg.solve(
        across.sum(axis=0) + weight * np.eye(3), np.einsum("vij,vj->i", across, centres) + weight * expected
    )
    ahead = np.einsum("vi,vi->v", rig.rotations[:, 2], point - centres)
    return point if (ahead > 0).all() else expected


def subject_distance(rig: Rig, view: int, given: float | None) -> float:
    """Metres along the optical axis of a single source camera to the subject: as given, else the look-at point's."""
    return (
        given
        if given is not None
        else float(rig.rotations[view, 2] @ (look_at_point(rig.subset([view])) - rig.centres[view]))
    )


def up_direction(rig: Rig) -> np.ndarray:
    """[3] unit vector that is up for the rig, from how its cameras stand and are held.

    The mean of the cameras' upward picture axes, where all cameras can be upright at once. Where they cannot, since
    their upward axes fan out although the cameras stand around something, all are rolled alike (pictures that lie on
    their side): up is then the direction in the picture plane that the cameras agree upon best, max over the angle a of
    abs(mean(cos a up + sin a right)), an eigenvector. Where each is rolled by an angle of its own, up is what the
    optical axes have least of (all around: vary least in). Of the two senses it is that of pictures that are rolled
    alike, else that in which cameras look down. Where cameras rolled alike look steeply up or down, it is righted by
    their pictures' lower edges.
    """
    right, upward, forward = rig.rotations[:, 0], -rig.rotations[:, 1], rig.rotations[:, 2]
    alike = np.stack([upward.mean(axis=0), right.mean(axis=0)])
    values, vectors = np.linalg.eigh(alike @ alike.T)
    held, agreed = float(np.linalg.norm(alike[0])), float(np.sqrt(max(values[1], 0.0)))
    up = alike[0] if held >= UPRIGHT * agreed else vectors[:, 1] @ alike
    pictures = float(alike[0] @ up)
    if len(rig) > 2 and np.hypot(*_mean_roll(rig, up)) < ALIKE:
        spread = forward - forward.mean(axis=0)
        about = spread if np.linalg.norm(forward.mean(axis=0)) < 0.5 else forward
        up, pictures = np.linalg.eigh(about.T @ about)[1][:, 0], 0.0
    if np.linalg.norm(up) < 1e-9:
        return upward[0]
    up = up / np.linalg.norm(up)
    votes = (pictures, _seen_from_above(forward, up), float(alike[1] @ up))
    return _righted(rig, up if next((v for v in votes if abs(v) > SURE), 1.0) > 0 else -up)


def _righted(rig: Rig, up: np.ndarray) -> np.ndarray:
    """[3] `up` [3], where a camera is steep (`STEEP`) the direction nearest to square to what lies level of cameras
    rolled alike: the lower edges of all their pictures, and the optical axes of those that look level."""
    cosine, sine = _mean_roll(rig, up)
    agreed = np.hypot(cosine, sine)
    if len(rig) < 2 or agreed < ALIKE:
        return up
    edges, forward = (cosine * rig.rotations[:, 0] + sine * rig.rotations[:, 1]) / agreed, rig.rotations[:, 2]
    square = edges.T @ edges + PULL * len(rig) * (np.eye(3) - np.outer(up, up))
    slope = np.abs(forward @ np.linalg.eigh(square)[1][:, 0])  # about what edges alone say, which no top camera tilts
    if slope.max() <= STEEP:
        return up
    weight = np.clip((STEEP - slope) / (STEEP - LEVEL), 0.0, 1.0)
    righted = np.linalg.eigh(square + (weight * forward.T) @ forward)[1][:, 0]
    return righted if righted @ up > 0 else -righted


def _seen_from_above(forward: np.ndarray, up: np.ndarray) -> float:
    """How far optical axes [V, 3] point away from `up` [3] (sine; negative: towards it): cameras at one height around
    something look along a cone, whose axis and slope are read off the plane through the tips; else their mean."""
    spread = forward - forward.mean(axis=0)
    values, vectors = np.linalg.eigh(spread.T @ spread)
    conical = len(forward) > 2 and values[0] < 0.1 * values[1]
    axis = vectors[:, 0] * (vectors[:, 0] @ up) if conical else up
    return -float(forward.mean(axis=0) @ axis)


def _mean_roll(rig: Rig, up: np.ndarray) -> tuple[float, float]:
    """Mean cosine and sine of the cameras' rolls against `up` [3]; as a vector 1 long where all are rolled alike."""
    roll = np.arctan2(rig.rotations[:, 0] @ up, -rig.rotations[:, 1] @ up)
    return float(np.cos(roll).mean()), float(np.sin(roll).mean())


def body_points(subject: np.ndarray, up: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """[96, 3] points on an upright ellipsoid of a person's height and radius, or as many times as large, around the
    subject, world metres."""
    side = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    latitude, longitude = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 8), np.arange(12) * np.pi / 6, indexing="ij")
    round_body = np.cos(longitude)[..., None] * side + np.sin(longitude)[..., None] * np.cross(up, side)
    points = (
        PERSON_RADIUS * np.cos(latitude)[..., None] * round_body + TALL_STATURE / 2 * np.sin(latitude)[..., None] * up
    )
    return subject + scale * points.reshape(-1, 3)
