"""Which pairs of cameras a run matches, why not the others, and what that leaves of the cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.geometry.pairs import MAX_ANGLE, PairReport, PairVerdict, shared_body
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, measured, unmeasured
from posegaussian.stages.inspection.planned import Planned
from posegaussian.storage.model.cameras import Rig

PARTNERED = (1.0, 0.6)
"""Share of the source cameras that some other is matched with. Of two cameras in four (`desk` of
docs/measurements/quality.md) pictures come apart; where all four have a partner (`balance`) they hold together."""
NEIGHBOURS = (50.0, MAX_ANGLE)
"""Degrees from a camera to its nearest partner: people filmed by eight cameras on a ring (45 degrees, a few more by
hand) come out whole; beyond 105 nothing is matched, see docs/measurements/rigs.md."""
REMEDY = {
    PairVerdict.TOO_WIDE: (
        "set a camera between them, or the cameras closer together: below {bound:g} degrees at the subject"
    ),
    PairVerdict.COINCIDENT: "move one of the two aside",
    PairVerdict.BEHIND: "move one of the two aside",
    PairVerdict.UNSEEN: "turn the camera to the subject, or leave it out with views.sources",
}
"""What to do about a pair that is refused, by reason."""


@dataclass(frozen=True)
class Rectified:
    """One pair."""

    views: tuple[int, int]
    """Indices of the cameras in the footage."""
    kind: str
    """ok, or the reason of `posegaussian.stages.geometry.pairs.PairVerdict`."""
    fate: str
    """matched, not needed (other partners are nearer), not asked for (not two sources, or depth compares no
    pictures), or refused."""
    angle: float
    """Degrees at the point that all cameras look at."""
    baseline: float
    """Metres between the cameras."""
    body: float
    """Share of what either picture shows of a person there that both show."""
    sentence: str
    """Why, with the value and the bound that decided."""


def rectified(rig: Rig, report: PairReport, fate: str, views: tuple[int, int]) -> Rectified:
    """One pair with the run's verdict on it; `views`: in the footage."""
    first, second = report.views
    baseline = float(np.linalg.norm(rig.centres[first] - rig.centres[second]))
    body = shared_body(rig, first, second, look_at_point(rig), up_direction(rig))
    kind = "ok" if report.usable else str(report.verdict)
    return Rectified(views, kind, fate, report.angle, baseline, body, report.sentence.partition(": ")[2])


def every_pair(planned: Planned) -> list[Rectified]:
    """All pairs of the footage."""
    place = {v: i for i, v in enumerate(planned.active)}
    return [
        rectified(planned.rig, r, _fate(planned, r), (place[r.views[0]], place[r.views[1]])) for r in planned.reports
    ]


def _fate(planned: Planned, report: PairReport) -> str:
    if not planned.matches or not set(report.views) <= set(planned.sources):
        return "not asked for"
    if tuple(sorted(report.views)) in planned.matched:
        return "matched"
    return "refused" if report in planned.refused else "not needed"


def of_pairs(planned: Planned, pairs: list[Rectified]) -> list[Finding]:
    """How many source cameras have a partner, how far neighbours are apart, and one note a pair."""
    return [_partners(planned), _neighbours(planned), *(_note(planned, p) for p in pairs)]


def _partners(planned: Planned) -> Finding:
    unit = "of the cameras"
    if not planned.matches:
        why = (
            "a single source camera has nobody to be matched with"
            if len(planned.sources) < 2
            else f"depth.method comes to {planned.depth.method}, which compares no pictures"
        )
        advice = "depth needs a second camera, or depth maps of your own" if len(planned.sources) < 2 else ""
        return unmeasured("partners", (), unit, *PARTNERED, why, advice)
    share = 1 - len(planned.alone) / len(planned.sources)
    told = "every source camera has a partner to be matched with"
    if planned.alone:
        told = (
            f"{planned.names(*planned.alone)} cannot be matched with any other: what only they see follows the hull of"
            f" the masks; {'; '.join(refusal(planned, v) for v in planned.alone[:3])}"
        )
    return measured(
        "partners",
        (),
        share,
        unit,
        *PARTNERED,
        told,
        "; ".join(dict.fromkeys(remedy(planned, v) for v in planned.alone)),
    )


def _nearest(planned: Planned, view: int) -> PairReport:
    """The refused pair of a source camera that is narrowest."""
    return min((r for r in planned.refused if view in r.views), key=lambda r: r.angle)


def refusal(planned: Planned, view: int) -> str:
    """A source camera's narrowest refused pair, with its angle and the true reason."""
    report = _nearest(planned, view)
    pair, _, why = report.sentence.partition(": ")
    return f"{pair} ({report.angle:.0f} degrees apart): {why}"


def remedy(planned: Planned, view: int) -> str:
    """What to do about it."""
    report = _nearest(planned, view)
    return (
        f"{planned.names(*report.views).replace(', ', ' and ')}:"
        f" {REMEDY[report.verdict].format(bound=planned.depth.max_angle)}"
    )


def _neighbours(planned: Planned) -> Finding:
    """How far the worst served camera is from its partner, and where cameras stand side by side."""
    unit, bounds = "degrees", (NEIGHBOURS[0], max(NEIGHBOURS[1], planned.depth.max_angle))
    if not planned.matches:
        return unmeasured("neighbours", (), unit, *bounds, "no pictures are compared, see partners")
    if planned.gap is None:
        nearest = min(planned.source_reports, key=lambda r: r.angle)
        told = f"no two source cameras can be matched; {refusal(planned, nearest.views[0])}"
        return Finding(
            "neighbours", (), nearest.angle, unit, *bounds, told, remedy(planned, nearest.views[0]), FindingVerdict.BAD
        )
    (widest, other), view = max((found, v) for v, found in planned.nearest.items())
    told = f"the nearest partner of {planned.rig.names[view]} is {planned.rig.names[other]}, {widest:.1f} degrees away"
    if planned.stretch is not None:
        order = " - ".join(planned.rig.names[v] for v in planned.stretch.views)
        told += (
            f"; cameras stand side by side, at most {planned.stretch.widest:.1f} degrees apart, over"
            f" {planned.stretch.span:.0f} of 360 degrees ({order})"
        )
    return measured(
        "neighbours",
        (),
        widest,
        unit,
        *bounds,
        told,
        f"more cameras between them: up to {NEIGHBOURS[0]:g} degrees apart a body comes out whole"
        " (docs/measurements/quality.md)",
    )


def _note(planned: Planned, pair: Rectified) -> Finding:
    names = tuple(planned.rig.names[planned.active[v]] for v in pair.views)
    sentence = (
        f"{pair.fate}: {pair.sentence}; {pair.angle:.1f} degrees apart, baseline {pair.baseline:.2f} m, {pair.body:.0%}"
        " of what they show of a person is in both pictures"
    )
    return Finding(
        "rectification",
        names,
        pair.angle,
        "degrees",
        0,
        0,
        sentence,
        "",
        FindingVerdict.GOOD if pair.kind == "ok" else FindingVerdict.NOTE,
    )
