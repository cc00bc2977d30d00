"""Which views can be matched with which: every pair gets a verdict, a measured value, its bound and a sentence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import combinations

import numpy as np

from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.geometry.subject import TALL_STATURE, body_points, look_at_point, up_direction
from posegaussian.storage.model.cameras import Rig

MAX_ANGLE = 105.0
"""Degrees at the subject; wider pairs see too little of the same surface."""
NARROW = 66.0
"""Degrees at the subject up to which two views see most of the same surface: a view with no two such partners leaves
much of what it shows to its limbs."""
NEAR = 50.0
"""Degrees at the subject within which two neighbours leave little of a view to chance."""
SHOWN = 75.0
"""Degrees up to which what lies between two views is shown without being asked for: five cameras all around are drawn
whole (docs/measurements/rigs.md), four are not."""
MIN_BASELINE = 0.02
"""Baseline per distance of the subject (1.1 degrees):
below it one pixel of disparity is a tenth of the distance and more."""
MIN_ASIDE = 20.0
"""Degrees between the baseline and either line of sight to the subject: below it one camera stands behind the other.
Eight cameras around a person, 45 degrees apart, in turn 2.0 and 4.4 m away, whose baselines lie 20 to 29 degrees aside,
gain 0.36 dB where neighbours are matched; in turn 1.8 and 5.2 m away, those that lie 20 degrees aside and more gain
0.06, with those of 16 and more 0.08 are lost, with those of 13 and more 1.5."""
SAME_BODY = 0.7
"""Share of what a view shows of a person that a partner must show to be one of those that are asked for (`enough`)."""
ALONG = (10.0, 150.0)
"""Degrees at the subject between two views up to which, and from which on, each looks along the other's rays, sees them
from end to end and cannot tell where on them a subject begins."""


class PairVerdict(StrEnum):
    """What a pair is good for."""

    USABLE = "usable"
    UNSEEN = "without the subject in view"
    TOO_WIDE = "too wide"
    COINCIDENT = "coincident"
    BEHIND = "one behind the other"


@dataclass(frozen=True)
class PairReport:
    """The verdict on one pair."""

    views: tuple[int, int]
    """Indices of the two views."""
    angle: float
    """Degrees between the lines of sight to the subject."""
    verdict: PairVerdict
    """Usable, or the first reason why not."""
    measured: float
    """The value that decided, in the unit the sentence names; the angle for a usable pair."""
    bound: float
    """The bound it was compared with."""
    sentence: str
    """The reason, for the plan and the log."""
    lean: float
    """Degrees by which the baseline is off level: 0 side by side, 90 one above the other. It refuses no pair."""
    shares: tuple[float, float]
    """Of what either view shows of a person, how much the other one shows (`share_shown`)."""

    @property
    def usable(self) -> bool:
        """Whether the pair may be matched."""
        return self.verdict is PairVerdict.USABLE


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees between two vectors [3]; exact for small angles, 0 where one of them vanishes."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def angle_at(subject: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
    """Degrees at the subject [3] between two camera centres [3]."""
    return angle_between(first - subject, second - subject)


def neighbour_angles(rig: Rig, sources: Sequence[int], nth: int = 1) -> np.ndarray:
    """[S] degrees from each of more than `nth` source views to the one that stands nearest to it, or `nth` nearest, at
    the point the cameras look at."""
    rig = rig.subset(sources)
    rays = rig.centres - look_at_point(rig)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    cosine = np.clip(rays @ rays.T, -1.0, 1.0)
    np.fill_diagonal(cosine, -1.0)
    return np.asarray(np.rad2deg(np.arccos(np.sort(cosine, axis=1)[:, -nth])))


def far_apart(rig: Rig, views: Sequence[int]) -> bool:
    """Whether half of the views, or more, have no two neighbours within `NEAR`."""
    return len(views) < 3 or bool(np.mean(neighbour_angles(rig, views, 2) > NEAR) >= 0.5)


def classify(
    rig: Rig,
    first: int,
    second: int,
    max_angle: float = MAX_ANGLE,
    subject: np.ndarray | None = None,
    up: np.ndarray | None = None,
) -> PairReport:
    """The verdict on one pair: the first of the tests below that fails, else usable. Symmetric in the two views.

    A view without the subject is told before all else: what its picture shows nobody can match. How cameras are held
    and which way the baseline runs is no test: `rectify` turns pictures. `subject` [3] (world metres) defaults to
    `look_at_point(rig)`, `up` [3] to `up_direction(rig)`, which a standing body follows; `max_angle` is in degrees.
    """
    subject = look_at_point(rig) if subject is None else subject
    up = up_direction(rig) if up is None else up
    sight = subject - rig.centres[[first, second]]
    baseline = rig.centres[second] - rig.centres[first]
    angle = angle_between(sight[0], sight[1])
    lean = abs(90.0 - angle_between(baseline, up))
    body = seen_bodies(rig, (first, second), subject, up)
    name = f"{rig.names[first]} and {rig.names[second]}"

    shares = share_shown(*body), share_shown(*body[::-1])

    def report(verdict: PairVerdict, measured: float, bound: float, sentence: str) -> PairReport:
        return PairReport((first, second), angle, verdict, measured, bound, f"{name}: {sentence}", lean, shares)

    for view, seen in ((first, body[0]), (second, body[1])):
        if not seen.any():
            return report(
                PairVerdict.UNSEEN,
                0.0,
                0.0,
                f"without the subject in view, {rig.names[view]} has nothing of a person at the point all cameras look"
                " at in its picture",
            )
    if not (body[0] & body[1]).any():
        return report(
            PairVerdict.UNSEEN,
            0.0,
            0.0,
            "without the subject in view of both, nothing that one picture shows of a person is in the other",
        )
    ratio = float(np.linalg.norm(baseline) / np.linalg.norm(sight, axis=1).min())
    if ratio < MIN_BASELINE:
        return report(
            PairVerdict.COINCIDENT,
            ratio,
            MIN_BASELINE,
            f"coincident, the baseline is {ratio:.2g} of the distance (at least {MIN_BASELINE:g})",
        )
    if angle > max_angle:
        return report(
            PairVerdict.TOO_WIDE,
            angle,
            max_angle,
            f"too wide, {angle:.1f} degrees at the subject (at most {max_angle:g}, setting depth.max_angle)",
        )
    aside = min(min(t, 180 - t) for t in (angle_between(baseline, s) for s in sight))
    if aside < MIN_ASIDE:
        return report(
            PairVerdict.BEHIND,
            aside,
            MIN_ASIDE,
            f"one behind the other, the baseline lies {aside:.1f} degrees off the line of sight (at least"
            f" {MIN_ASIDE:g})",
        )
    try:
        rectify(rig, first, second, subject, up=up)
    except ValueError as e:
        return report(PairVerdict.BEHIND, aside, MIN_ASIDE, f"one behind the other as they look, {e}")
    return report(PairVerdict.USABLE, angle, max_angle, f"usable, {angle:.1f} degrees at the subject")


def shared_body(rig: Rig, first: int, second: int, subject: np.ndarray, up: np.ndarray) -> float:
    """What both pictures show of a person, over what the one shows that shows more of it; 0 where neither shows any."""
    a, b = seen_bodies(rig, (first, second), subject, up)
    return float((a & b).sum() / max(a.sum(), b.sum(), 1))


def share_shown(own: np.ndarray, other: np.ndarray) -> float:
    """How much of what a view shows of a person another one shows, of points [N] that each shows; 0 of nothing."""
    return float((own & other).sum() / max(own.sum(), 1))


def seen_bodies(rig: Rig, views: tuple[int, int], subject: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[96] bool each: which points of a person at the subject lie inside each of two source pictures. A picture of a
    face has none of them, all lie around it: where the two have none in common, they are of a body as high as what the
    smaller one shows, if that has some in common."""
    whole = _seen(rig, views, body_points(subject, up))
    if (whole[0] & whole[1]).any():
        return whole
    high = min(_field(rig, v, subject) for v in views)
    part = _seen(rig, views, body_points(subject, up, min(1.0, high / TALL_STATURE)))
    return part if (part[0] & part[1]).any() else whole


def _field(rig: Rig, view: int, subject: np.ndarray) -> float:
    """Metres that the shorter side of a picture spans at the depth of the subject; 0 behind the camera."""
    depth = float(rig.rotations[view, 2] @ (subject - rig.centres[view]))
    return max(depth, 0.0) * float((rig.size[view] / rig.intrinsics[view, [0, 1], [0, 1]]).min())


def _seen(rig: Rig, views: tuple[int, int], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[N] bool each: which of world points [N, 3] lie inside each of two source pictures."""
    a, b = (_inside(*project(points, rig.intrinsics[v], rig.world_to_camera[v]), rig.size[v]) for v in views)
    return a, b


def _inside(pixels: np.ndarray, depth: np.ndarray, size: np.ndarray) -> np.ndarray:
    return (depth > 0) & (pixels >= 0).all(axis=-1) & (pixels <= size).all(axis=-1)


def pair_report(
    rig: Rig,
    views: Sequence[int] | None = None,
    max_angle: float = MAX_ANGLE,
    believed: Sequence[int] | None = None,
) -> list[PairReport]:
    """The verdict on every pair of the given views (default: all), in the order of the views. Where the subject is the
    `believed` ones say (default: these views), and no camera that is held out or contradicts the others."""
    pairs_of = tuple(range(len(rig)) if views is None else views)
    return list(_reports(rig, pairs_of, max_angle, pairs_of if believed is None else tuple(believed)))


@lru_cache(maxsize=16)
def _reports(rig: Rig, views: tuple[int, ...], max_angle: float, believed: tuple[int, ...]) -> tuple[PairReport, ...]:
    """A plan asks for the same pairs more than once: for its notes, the default path and the depth."""
    seen = rig.subset(believed)
    subject, up = look_at_point(seen), up_direction(seen)
    return tuple(classify(rig, a, b, max_angle, subject, up) for a, b in combinations(views, 2))


def choose_pairs(
    rig: Rig,
    sources: Sequence[int],
    count: int,
    max_angle: float = MAX_ANGLE,
    reports: Sequence[PairReport] | None = None,
) -> dict[int, list[int]]:
    """For each source view its usable partners, narrowest angle first, the lower index first at equal angles: `count`
    of them, and those close-ups among them that `enough` adds.

    `reports` are those of `pair_report` where the caller has them; pairs with a view outside `sources` are left out.
    Angles are compared to a tenth of a degree, so that rounding does not decide between the two sides of a ring.
    """
    reports = pair_report(rig, sources, max_angle) if reports is None else reports
    partners: dict[int, list[tuple[float, int, float]]] = {v: [] for v in sources}
    for report in reports:
        a, b = report.views
        if report.usable and a in partners and b in partners:
            partners[a].append((round(report.angle, 1), b, report.shares[0]))
            partners[b].append((round(report.angle, 1), a, report.shares[1]))
    chosen = {}
    for v, found in partners.items():
        share = {b: shown for _, b, shown in found}
        chosen[v] = enough([b for _, b, _ in sorted(found)], count, share.__getitem__)
    return chosen


def enough(partners: Sequence[int], count: int, share: Callable[[int], float]) -> list[int]:
    """The first `count` of a view's partners, nearest first, of which each shows `SAME_BODY` of what it shows of a
    person, `share` of each; and as many nearer ones, at most, that show less, such as a close-up of the face: that
    takes nobody's place, or what lies beside it would be compared with nothing."""
    chosen: list[int] = []
    whole = part = 0
    for view in partners:
        if whole == count:
            break
        if share(view) >= SAME_BODY:
            whole += 1
        elif part < count:
            part += 1
        else:
            continue
        chosen.append(view)
    return chosen


def alone(rig: Rig, views: Sequence[int], max_angle: float = MAX_ANGLE) -> tuple[int, ...]:
    """Which of several views nothing tells how far away the subject is from: no usable pair serves them, and all others
    look along their rays (`ALONG`). A view that is the only one is none of them."""
    if len(views) < 2:
        return ()
    reports = pair_report(rig, views, max_angle)
    told = {v for r in reports if r.usable or ALONG[0] < r.angle < ALONG[1] for v in r.views}
    return tuple(v for v in views if v not in told)


def pair_notes(rig: Rig, sources: Sequence[int], max_angle: float = MAX_ANGLE) -> list[str]:
    """Sentences for the plan about pairs that are not matched:
    one a verdict with an example, one for views no pair serves but others see from the side."""
    reports = pair_report(rig, sources, max_angle)
    notes = []
    for verdict in PairVerdict:
        refused = [r for r in reports if r.verdict is verdict and not r.usable]
        if refused:
            nearest = min(refused, key=lambda r: r.angle)
            notes.append(
                f"depth does not match {len(refused)} of {len(reports)} pairs of views, which are {verdict}; the"
                f" nearest: {nearest.sentence}"
            )
    served = {v for r in reports if r.usable for v in r.views}.union(alone(rig, sources, max_angle))
    unmatched = [rig.names[v] for v in sources if v not in served]
    if unmatched:
        notes.append(f"no usable pair serves {', '.join(unmatched)}: hull depth with low confidence there")
    return notes
