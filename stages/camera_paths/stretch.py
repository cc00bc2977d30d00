"""Where cameras stand side by side: the stretch around the subject in which every picture lies between two that
depth can match."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from posegaussian.stages.geometry.pairs import ALONG, MAX_ANGLE, SHOWN, PairReport, PairVerdict, pair_report
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.storage.model.cameras import CameraPath, Rig

STEEPEST = 80.0
"""Degrees above or below the subject from which on a camera stands nowhere around it."""
LEAST = np.radians(1.0)
"""Azimuth between neighbours; nearer ones stand one above the other."""
FLAT = 0.1
"""Ratio of the two least spreads of the directions to the cameras, up to which they lie in one plane."""
TURN = 2 * np.pi
Angles = Mapping[tuple[int, int], float]
"""Degrees at the subject of the pairs that stand `side_by_side`, in both orders."""


@dataclass(frozen=True)
class Stretch:
    """Source cameras in the order in which they stand around the subject; each stands `side_by_side` with the next."""

    views: tuple[int, ...]
    """Indices of the cameras, right-handed about the rig's up; the first of a closed one is the lowest."""
    closed: bool
    """Whether the last stands side by side with the first, all the way around."""
    widest: float
    """Degrees at the subject between the neighbours that are farthest apart."""
    span: float
    """Degrees around the subject that it covers, of 360."""


@dataclass(frozen=True, eq=False)
class _Standing:
    """Where cameras stand around the subject."""

    azimuth: np.ndarray
    """[V] radians."""
    elevation: np.ndarray
    """[V] degrees."""

    def cost(self, a: int, b: int, step: float) -> float:
        """Of going from one camera to another, `step` radians of azimuth on: squared degrees. The angle at the subject
        would be cheap high up, where a ring is short."""
        return float(np.degrees(step) ** 2 + (self.elevation[b] - self.elevation[a]) ** 2)

    def weighed(self, chain: _Chain) -> float:
        """Cost of a way, more the farther it is from level: rings of a dome are never quite equally even. Too little to
        leave out a camera for being high."""
        off_level = np.abs(self.elevation[list(chain.views)]).mean() / 90
        return round(chain.cost * (1 + float(off_level) ** 2), 1)


@dataclass(frozen=True)
class _Chain:
    """The way from one camera: how far it gets (radians), how evenly, and past whom."""

    azimuth: float
    cost: float
    views: tuple[int, ...]


def side_by_side(report: PairReport) -> bool:
    """Whether what lies between two cameras, near enough for the report's bound, is seen by both from its sides.

    One may stand much farther back than the other, so that the two cannot be rectified: pictures are compared without,
    but for those that look along each other's rays.
    """
    return report.usable or (report.verdict is PairVerdict.BEHIND and report.angle > ALONG[0])


def best_stretch(rig: Rig, sources: Sequence[int], max_angle: float = MAX_ANGLE) -> Stretch | None:
    """The stretch of the largest group of source cameras, at equal size that with the narrowest gaps; None where no two
    that can be matched stand near enough.

    Groups are what pairs `side_by_side` within `SHOWN` degrees hold together. Within one the stretch goes all the way
    around where it can, else as far as it can, and by the sum of squared steps in azimuth and in elevation: past every
    camera between, but not up and down between two rows of them. Of rings about as even, such as those of a dome, it is
    the one nearest to the subject's height.
    """
    angles: dict[tuple[int, int], float] = {}
    for report in pair_report(rig, sources, min(max_angle, SHOWN)):
        if side_by_side(report):
            angles[report.views] = angles[report.views[::-1]] = round(report.angle, 1)
    _, _, height, flat = around(rig, sources)
    standing = _Standing(_azimuths(rig, sources), np.degrees(np.arctan2(height, flat)))
    found = [_of_group(group, angles, standing) for group in _groups(sources, angles)]
    known = [(size, stretch) for size, stretch in found if stretch is not None]
    return min(known, key=lambda f: (-f[0], f[1].widest, f[1].views[0]))[1] if known else None


def stretch_notes(rig: Rig, sources: Sequence[int], max_angle: float, paths: Mapping[str, CameraPath]) -> list[str]:
    """Sentences for the plan on what a path `between` the source cameras leaves out."""
    stretch = best_stretch(rig, sources, max_angle)
    passed = [p.name for p in paths.values() if p.kind == "between"]
    beside = [rig.names[v] for v in sources if stretch is not None and v not in stretch.views]
    if stretch is None or not beside:
        return []
    order = " - ".join(rig.names[v] for v in stretch.views)
    return [
        f"camera path {p} stays where pictures lie between two cameras that depth can match within"
        f" {min(max_angle, SHOWN):g} degrees, {order}; it does not pass {', '.join(beside)} (for these: --path orbit,"
        " or 'arc CAM_A CAM_B')"
        for p in passed
    ]


def around(rig: Rig, sources: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Subject [3], the axis through it that source cameras stand around [3], and how far along the axis and how far
    from it each camera is [V], metres.

    The axis is the rig's up, and what is along it height, but where cameras stand above each other rather than side by
    side: then it lies across, and the way around is up and down.
    """
    own = rig.subset(sources)
    subject, axis = look_at_point(own), up_direction(own)
    offset, toward = rig.centres - subject, own.centres - subject
    toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(toward.T @ toward)
    across = vectors[:, 0]
    if values[0] < FLAT * values[1] and abs(across @ axis) < np.sqrt(0.5):
        axis = across if across @ np.cross(axis, toward.mean(axis=0)) >= 0 else -across
    height = offset @ axis
    return subject, axis, height, np.linalg.norm(offset - height[:, None] * axis, axis=1)


def directions(rig: Rig, sources: Sequence[int], first: int) -> tuple[np.ndarray, np.ndarray]:
    """Two axes [3] across the one that source cameras stand around: towards camera `first`, and a quarter turn on,
    right-handed."""
    subject, axis, height, _ = around(rig, sources)
    flat = rig.centres[first] - subject - height[first] * axis
    side = flat / np.linalg.norm(flat)
    return side, np.cross(axis, side)


def _azimuths(rig: Rig, sources: Sequence[int]) -> np.ndarray:
    """[V] radians about the axis that source cameras stand around; not a number for cameras that stand on it."""
    subject, _, height, flat = around(rig, sources)
    stands = np.abs(height) <= np.tan(np.radians(STEEPEST)) * flat
    if not stands.any():
        return np.full(len(rig), np.nan)
    side, on = directions(rig, sources, int(np.argmax(stands)))
    offset = rig.centres - subject
    return np.where(stands, np.arctan2(offset @ on, offset @ side), np.nan)


def _groups(sources: Sequence[int], angles: Angles) -> list[list[int]]:
    """Sources that pairs side by side hold together, directly or through others."""
    left, groups = list(sources), []
    while left:
        group = [left.pop(0)]
        for view in group:  # grows while it is walked through
            near = [v for v in left if (view, v) in angles]
            group += near
            left = [v for v in left if v not in near]
        groups.append(sorted(group))
    return groups


def _of_group(group: list[int], angles: Angles, standing: _Standing) -> tuple[int, Stretch | None]:
    """How many cameras the group has, and its stretch."""
    rings, arcs = [], []
    for start in group:
        chains = _chains(start, group, angles, standing)
        arcs.append(min(chains, key=lambda c: (-round(c.azimuth, 3), c.cost, c.views)))
        for c in chains:
            step = (TURN - c.azimuth) if c.azimuth > 0 else np.inf
            if (c.views[-1], start) in angles and LEAST < step < np.pi:
                rings.append(_Chain(TURN, c.cost + standing.cost(c.views[-1], start, step), c.views))
    if rings:
        views = min(rings, key=lambda c: (standing.weighed(c), min(c.views), c.views)).views
        first = views.index(min(views))
        views = views[first:] + views[:first]
        return len(group), Stretch(
            views, True, max(angles[a, b] for a, b in zip(views, views[1:] + views[:1], strict=True)), 360.0
        )
    longest = min(arcs, key=lambda c: (-round(c.azimuth, 3), standing.weighed(c), c.views))
    if len(longest.views) < 2:
        return len(group), None
    return len(group), Stretch(
        longest.views, False, max(angles[a, b] for a, b in pairwise(longest.views)), float(np.degrees(longest.azimuth))
    )


def _chains(start: int, group: list[int], angles: Angles, standing: _Standing) -> list[_Chain]:
    """The most even way from `start` to every camera of the group that can be reached with growing azimuth, less
    than once around."""
    azimuth = standing.azimuth
    ahead = {
        v: float((azimuth[v] - azimuth[start]) % TURN)
        for v in group
        if v != start and np.isfinite(azimuth[[v, start]]).all()
    }
    best = {start: _Chain(0.0, 0.0, (start,))}
    for v in sorted(ahead, key=lambda v: (ahead[v], v)):
        ways = [
            _Chain(ahead[v], c.cost + standing.cost(u, v, ahead[v] - c.azimuth), (*c.views, v))
            for u, c in best.items()
            if (u, v) in angles and LEAST < ahead[v] - c.azimuth < np.pi
        ]
        if ways:
            best[v] = min(ways, key=lambda c: (round(c.cost, 1), c.views))
    return list(best.values())
