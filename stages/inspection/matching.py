"""Findings from features that pairs of cameras share: does the calibration hold for the pictures?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.epipolar import fundamental
from posegaussian.stages.geometry.features import Features, features, matched
from posegaussian.stages.geometry.matches import EpipolarFit, epipolar_fit
from posegaussian.stages.inspection.finding import Finding, measured, unmeasured
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.inspection.pairs import Rectified

WIDEST = 55.0
"""Degrees at the subject beyond which features
of the same place no longer look alike (SIFT loses them from 40 to 50 degrees on)."""
MOST_PAIRS = 40
"""Pairs whose features are compared, narrowest first."""
EPIPOLAR = (1.0, 3.0)
"""Captured px: a feature lies within one. Rows that are 3 px apart are not matched, and silhouettes that are 3 px
off cut fingers away."""
LARGE = (0.001, 0.003)
"""The same as a share of the longer side, which counts for pictures of more than 1000 px: 2.4 and 7 mm on a person
who fills it."""
ADVICE = (
    "calibrate again, or look for a wrong size, crop, unit or direction of the pose: these matched points fit each"
    " other, but not the calibration (or the cameras are out of step, where points on the subject miss their lines and"
    " those around it do not)"
)


@dataclass(frozen=True, eq=False)
class Matched:
    """What features say about one pair."""

    views: tuple[int, int]
    """Indices of the cameras."""
    first: np.ndarray
    """[n, 2] px of `rig`, in the first camera."""
    second: np.ndarray
    """[n, 2] in the second."""
    numbers: np.ndarray
    """[n] the frame in which each was matched."""
    fit: EpipolarFit
    """Their verdict, px of `rig`."""
    px: float
    """Captured px per px of `rig`, mean of both cameras."""


def matched_pairs(footage: Footage, pairs: list[Rectified]) -> list[Matched]:
    """Matches of all pairs narrow enough, over the frames that are looked at."""
    narrow = sorted((p for p in pairs if p.angle <= WIDEST and p.kind != "coincident"), key=lambda p: p.angle)[
        :MOST_PAIRS
    ]
    wanted = sorted({v for p in narrow for v in p.views})
    found = {
        (v, n): features(picture, footage.warps[v].coverage)
        for n in footage.looked_at
        for v in wanted
        if (picture := footage.picture(v, n)) is not None
    }
    return [_matched(footage, p.views, found) for p in sorted(narrow, key=lambda p: p.views)]


def _matched(footage: Footage, views: tuple[int, int], found: dict[tuple[int, int], Features]) -> Matched:
    a, b = views
    first, second, numbers = [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros(0, int)]
    for n in footage.looked_at:
        if (a, n) in found and (b, n) in found:
            pairs = matched(found[a, n], found[b, n])
            first.append(found[a, n].points[pairs[:, 0]])
            second.append(found[b, n].points[pairs[:, 1]])
            numbers.append(np.full(len(pairs), n))
    x, y, of = np.concatenate(first), np.concatenate(second), np.concatenate(numbers)
    # What stands still is matched in every frame at the same place; it counts once.
    _, once = np.unique(np.concatenate([x, y], axis=1).round(0), axis=0, return_index=True)
    x, y, of = x[np.sort(once)], y[np.sort(once)], of[np.sort(once)]
    return Matched(
        views,
        x,
        y,
        of,
        epipolar_fit(fundamental(footage.rig, a, b), x, y, float(footage.rig.size[[a, b]].max())),
        float(footage.px[[a, b]].mean()),
    )


def of_matches(footage: Footage, pairs: list[Rectified], found: list[Matched]) -> list[Finding]:
    """One finding a pair: the median epipolar distance of the points that are held for right matches."""
    by_pair = {m.views: m for m in found}
    return [_of_pair(footage, p, by_pair.get(p.views)) for p in pairs]


def _of_pair(footage: Footage, pair: Rectified, found: Matched | None) -> Finding:
    names = tuple(footage.names[v] for v in pair.views)
    longest = float(footage.longest[list(pair.views)].max())
    good, bad = (round(max(least, share * longest), 2) for least, share in zip(EPIPOLAR, LARGE, strict=True))
    what = "epipolar distance"
    if found is None:
        why = (
            "they stand in the same place"
            if pair.kind == "coincident"
            else (
                f"{pair.angle:.0f} degrees apart at the subject, features look alike up to {WIDEST:g}"
                if pair.angle > WIDEST
                else f"the {MOST_PAIRS} narrowest pairs were looked at"
            )
        )
        return unmeasured(what, names, "px", good, bad, f"not compared: {why}")
    fit, n = found.fit, len(found.first)
    if fit.error is None:
        return unmeasured(
            what,
            names,
            "px",
            good,
            bad,
            f"{n} matched points tell nothing: they agree neither"
            " with the calibration nor with each other beyond chance",
            "a textured background, a carpet or posters give features",
        )
    error = fit.error * found.px
    right = int(fit.agree.sum())
    close = int((fit.distances[fit.agree] * found.px <= good).sum())
    freely = (
        f"; without any calibration {int(fit.free.sum())} fit each other within a median of"
        f" {fit.free_error * found.px:.2f} px"
        if fit.free_error is not None
        else ""
    )
    return measured(
        what,
        names,
        error,
        "px",
        good,
        bad,
        f"{right} of {n} matched points are held for right, {close} of them within {good:g} px of the calibration's"
        f" lines, median {error:.2f} px{freely}",
        ADVICE,
    )
