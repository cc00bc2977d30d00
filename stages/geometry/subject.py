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


def expected_distance(rig: Rig) -> np.ndarray:
    """[V] metres at which a person fills three quarters of each camera's longer side."""
    focal = rig.intrinsics[:, [0, 1], [0, 1]].mean(axis=1)
    return focal * TALL_STATURE / (FILLED * rig.size.max(axis=1))


def look_at_point(rig: Rig) -> np.ndarray:
    """[3] the world point nearest to all optical axes, metres.

    Least squares over the axes with a pull (weight 1e-4) towards the points at `expected_distance`, which decides where
    the axes are parallel. When the result lies behind a camera the mean of those points is taken instead.
    """
    axes, centres = rig.rotations[:, 2], rig.centres
    expected = (centres + axes * expected_distance(rig)[:, None]).mean(axis=0)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    weight = 1e-4 * len(rig)
    point = np.linalg.solve(
        across.sum(axis=0) + weight * np.eye(3), np.einsum("vij,vj->i", across, centres) + weight * expected
    )
    ahead = np.einsum("vi,vi->v", axes, point - centres)
    return point if (ahead > 0).all() else expected


def subject_distance(rig: Rig, view: int, given: float | None) -> float:
    """Metres along the optical axis of a single source camera to the subject: as given, else the look-at point's."""
    return (
        given
        if given is not None
        else float(rig.rotations[view, 2] @ (look_at_point(rig.subset([view])) - rig.centres[view]))
    )


def up_direction(rig: Rig) -> np.ndarray:
    """[3] unit mean of the cameras' upward picture axes in the world; the first camera's where they cancel out."""
    up = -rig.rotations[:, 1].mean(axis=0)
    length = np.linalg.norm(up)
    return up / length if length > 0.1 else -rig.rotations[0, 1]


def body_points(subject: np.ndarray, up: np.ndarray) -> np.ndarray:
    """[96, 3] points on an upright ellipsoid of a person's height and radius around the subject, world metres."""
    side = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    latitude, longitude = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 8), np.arange(12) * np.pi / 6, indexing="ij")
    round_body = np.cos(longitude)[..., None] * side + np.sin(longitude)[..., None] * np.cross(up, side)
    points = (
        PERSON_RADIUS * np.cos(latitude)[..., None] * round_body + TALL_STATURE / 2 * np.sin(latitude)[..., None] * up
    )
    return subject + points.reshape(-1, 3)
