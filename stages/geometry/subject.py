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
QUARTERS = np.array([[0.0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]])
"""Upward, right, downward and left axis of a picture in camera axes: what is up in it once it is turned by quarters."""
BETTER = 0.97
"""Length of the mean upward axis of cameras as they are, over that of cameras turned by quarters, above which none is
turned: 0.94 where one of 16 is mounted sideways, 0.90 where one of 8 is."""
STANDING = 0.85
"""Length of the mean upward axis down to which turned cameras are believed: they look 30 degrees up or down at most.
Three all around with one above and one below reach 0.79 with a level direction for up."""
ALIGNED = np.cos(np.radians(15.0))
"""Length of the mean roll above which cameras agree upon what is up: those rolled by 15 degrees one way or the other
have it, those turned by the best quarters, but rolled each in its own way, 0.90. One of 30 that is mounted sideways,
which tilts up by 2 degrees, leaves it as long."""
COMMON = np.sin(np.radians(20.0))
"""Sine of the roll that all cameras may share and still stand upright or lie on their side: where one of three all
around is mounted sideways, all agree upon something else with a roll of 35 degrees, or of 42."""
HELD_UPRIGHT, HELD_SIDEWAYS = 0.35, 0.7
"""What cameras that are rolled alike must see of up in their pictures to be believed at once: they look up or down by
70 degrees at most, by 45 where they lie on their side. One of two side by side that is mounted sideways leaves 0.28
of an up along their optical axes, one of three all around that stands on its head 0.67 of an up that lies level."""
PULL = 0.03
"""Weight beside a camera's of the upward picture axes' own mean, which decides where all lower edges are parallel."""
LEANING = np.cos(np.radians(6.0))
"""Cosine of the angle between the upward axes' mean and what the lower edges say from which on the edges may be
believed: below it the mean is as near, and steadier where cameras are rolled a little, each in its own way."""
STRAY = np.sin(np.radians(5.0))
"""Sine of the angle by which edges may stray from level, root mean square, for that to be believed. Of four cameras
over 90 degrees, 1.8 m high, whose rolls scatter by 4 degrees, the edges say up within 3.8 degrees and the mean within
13.9; where rolls scatter by 16 neither is better."""
LYING = np.sin(np.radians(15.0))
"""Sine of the angle up to which pictures lie so squarely on their side that cameras looking down say more."""
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
    optical axes have least of (all around: vary least in). It is righted by the pictures' lower edges, where those say
    more. Of the two senses it is that of pictures that are rolled alike, but do not lie on their side, else that in
    which cameras look down. Where cameras agree better once some are turned by quarters, as one does that is mounted
    sideways, they are asked so.
    """
    up = _up_of(rig.rotations)
    turned = _turned_by_quarters(rig.rotations, up)
    return up if turned is None else _up_of(turned)


def _up_of(rotations: np.ndarray) -> np.ndarray:
    """[3] what `up_direction` says of cameras [V, 3, 3] none of which is turned by a quarter against the others."""
    right, upward, forward = rotations[:, 0], -rotations[:, 1], rotations[:, 2]
    alike = np.stack([upward.mean(axis=0), right.mean(axis=0)])
    values, vectors = np.linalg.eigh(alike @ alike.T)
    held, agreed = float(np.linalg.norm(alike[0])), float(np.sqrt(max(values[1], 0.0)))
    up = alike[0] if held >= UPRIGHT * agreed else vectors[:, 1] @ alike
    each = len(rotations) > 2 and np.hypot(*_mean_roll(rotations, up)) < ALIKE
    if each:
        spread = forward - forward.mean(axis=0)
        about = spread if np.linalg.norm(forward.mean(axis=0)) < 0.5 else forward
        up = np.linalg.eigh(about.T @ about)[1][:, 0]
    if np.linalg.norm(up) < 1e-9:
        return upward[0]
    up = _righted(rotations, up / np.linalg.norm(up))
    edges = _lower_edges(rotations, up)
    level = up if edges is None else _square_to(edges, up)  # leans over less, be it righted or not
    pictures = 0.0 if each else float(alike[0] @ level)
    above = _seen_from_above(forward, level)
    votes = (pictures if abs(pictures) > LYING else 0.0, above, pictures, float(alike[1] @ level))
    return up if next((v for v in votes if abs(v) > SURE), 1.0) > 0 else -up


def _righted(rotations: np.ndarray, up: np.ndarray) -> np.ndarray:
    """[3] `up` [3] as what lies level of cameras [V, 3, 3] rolled alike corrects it, else `up` itself.

    Where a camera is steep (`STEEP`), the direction nearest to square to the lower edges of all pictures and to the
    optical axes of cameras that look level. Where none is, but all look down from one side, the mean of their upward
    axes leans over by as much: the direction nearest to square to the edges alone, where it lies far from that mean
    (`LEANING`) and the edges agree about it (`STRAY`).
    """
    count, forward = len(rotations), rotations[:, 2]
    edges = _lower_edges(rotations, up)
    if count < 2 or edges is None:
        return up
    level = _square_to(edges, up)  # about what edges alone say, which no top camera tilts
    slope = np.abs(forward @ level)
    if slope.max() > STEEP:
        weight = np.clip((STEEP - slope) / (STEEP - LEVEL), 0.0, 1.0)
        return _square_to(edges, up, (weight * forward.T) @ forward)
    if level @ up > LEANING:
        return up
    stray = np.linalg.norm(edges @ level) / np.sqrt(max(count - 2, 1))  # any two edges lie level of something
    return level if stray < STRAY else up


def _lower_edges(rotations: np.ndarray, up: np.ndarray) -> np.ndarray | None:
    """[V, 3] what runs along the lower edge of the pictures of cameras [V, 3, 3], turned back by the roll against `up`
    [3] that they have in common, or None where each is rolled in its own way."""
    cosine, sine = _mean_roll(rotations, up)
    agreed = np.hypot(cosine, sine)
    return None if agreed < ALIKE else (cosine * rotations[:, 0] + sine * rotations[:, 1]) / agreed


def _square_to(edges: np.ndarray, up: np.ndarray, others: np.ndarray | float = 0.0) -> np.ndarray:
    """[3] unit vector nearest to square to edges [V, 3], and to what has the moments `others` [3, 3], on the side of
    `up` [3] and pulled to it (`PULL`)."""
    square = edges.T @ edges + PULL * len(edges) * (np.eye(3) - np.outer(up, up)) + others
    found = np.linalg.eigh(square)[1][:, 0]
    return found if found @ up > 0 else -found


def _seen_from_above(forward: np.ndarray, up: np.ndarray) -> float:
    """How far optical axes [V, 3] point away from `up` [3] (sine; negative: towards it): cameras at one height around
    something look along a cone, whose axis and slope are read off the plane through the tips; else, and where they are
    three, whose tips always lie in one, their mean."""
    spread = forward - forward.mean(axis=0)
    values, vectors = np.linalg.eigh(spread.T @ spread)
    conical = len(forward) > 3 and values[0] < 0.1 * values[1]
    axis = vectors[:, 0] * (vectors[:, 0] @ up) if conical else up
    return -float(forward.mean(axis=0) @ axis)


def _mean_roll(rotations: np.ndarray, up: np.ndarray) -> tuple[float, float]:
    """Mean cosine and sine of the rolls of cameras [V, 3, 3] against `up` [3]; as a vector 1 long where all are rolled
    alike."""
    roll = np.arctan2(rotations[:, 0] @ up, -rotations[:, 1] @ up)
    return float(np.cos(roll).mean()), float(np.sin(roll).mean())


def _turned_by_quarters(rotations: np.ndarray, up: np.ndarray) -> np.ndarray | None:
    """World to camera [V, 3, 3] -> the same of cameras turned about their optical axes by those quarters with which
    they agree best upon what is up, or None where all turn alike or `up` [3] is as good for cameras as they are.

    Every camera's four picture axes are starts: each camera chooses that of its own which lies nearest, these have a
    mean, and so on. Of the longest means (`UPRIGHT`) that wins for which most cameras stay as they are, then the one
    from which cameras look down.
    """
    if _alike(rotations, up):
        return None
    axes, views = QUARTERS @ rotations, np.arange(len(rotations))
    mean = axes.reshape(-1, 3)
    for _ in range(8):  # it settles in two or three
        chosen = np.einsum("vqi,si->svq", axes, mean).argmax(axis=2)
        mean = axes[views, chosen].mean(axis=1)
    length = np.linalg.norm(mean, axis=1)
    kept = np.where(length >= UPRIGHT * length.max(), (chosen == 0).sum(axis=1), -1)
    first = np.flatnonzero(kept == kept.max())
    best = first[np.argmin(mean[first] @ rotations[:, 2].mean(axis=0))]
    if length[best] < STANDING or _in_pictures(rotations, up) > BETTER * length[best]:
        return None
    quarter = chosen[best]
    turned = np.stack([axes[views, (quarter + 1) % 4], axes[views, (quarter + 2) % 4], rotations[:, 2]], axis=1)
    return turned if np.ptp(quarter) > 0 and np.hypot(*_mean_roll(turned, mean[best])) > ALIGNED else None


def _alike(rotations: np.ndarray, up: np.ndarray) -> bool:
    """Whether cameras [V, 3, 3] are all upright against `up` [3], on their head, or on one side, or rolled alike and
    level, so that no turn by quarters is looked for: it would be found for some that look down as they should."""
    cosine, sine = np.abs(_mean_roll(rotations, up))
    least = HELD_UPRIGHT if sine < COMMON else HELD_SIDEWAYS if cosine < COMMON else STANDING
    return bool(np.hypot(cosine, sine) > ALIGNED and _in_pictures(rotations, up) > least)


def _in_pictures(rotations: np.ndarray, up: np.ndarray) -> float:
    """Length, 0 to 1, of the mean of what `up` [3] is in the planes of the pictures of cameras [V, 3, 3]: 1 where all
    look level and are rolled alike."""
    return float(np.linalg.norm((rotations[:, :2] @ up).mean(axis=0)))


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
