"""What each pair of cameras is good for when it is rectified."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from stages.geometry.pairs import MAX_ANGLE, MIN_BODY, Verdict, body_share, classify
from stages.geometry.subject import look_at_point, up_direction
from stages.inspection.finding import Finding, measured, unmeasured
from stages.inspection.finding import Verdict as Grade
from storage.rig import Rig

USELESS = 0.5
"""Share of the body that stays inside the rectified pictures below which a pair is useless rather than clipped."""
PARTNERED = (0.5, 0.0)
"""Share of the cameras that have a partner to be matched with; never bad, as the sweep and the hull do without."""


@dataclass(frozen=True)
class Rectified:
    """One pair."""

    views: tuple[int, int]
    """Indices of the cameras."""
    kind: str
    """ok, wide, clipped, useless, vertical, rolled, coincident, or one behind the other."""
    angle: float
    """Degrees at the point that all cameras look at."""
    baseline: float
    """Metres between the cameras."""
    body: float
    """Share of a person there that both pictures keep when they are rectified."""
    sentence: str
    """Why, with the value and the bound that decided."""


def rectified(rig: Rig, first: int, second: int, max_angle: float = MAX_ANGLE) -> Rectified:
    """The verdict on one pair: that of the pipeline (`stages.geometry.pairs.classify`), too wide ones told apart by what is left of the body."""
    subject, up = look_at_point(rig), up_direction(rig)
    report = classify(rig, first, second, max_angle, subject, up)
    baseline = float(np.linalg.norm(rig.centres[first] - rig.centres[second]))
    body = body_share(rig, first, second, subject, up)
    kind = "ok" if report.usable else str(report.verdict)
    if report.verdict is Verdict.TOO_WIDE:
        kind = "useless" if body < USELESS else "clipped" if body < MIN_BODY else "wide"
    return Rectified((first, second), kind, report.angle, baseline, body, report.sentence)


def every_pair(rig: Rig, max_angle: float = MAX_ANGLE) -> list[Rectified]:
    """All pairs."""
    return [rectified(rig, a, b, max_angle) for a, b in combinations(range(len(rig)), 2)]


def of_pairs(rig: Rig, pairs: list[Rectified], max_angle: float = MAX_ANGLE) -> list[Finding]:
    """One note a pair, and a finding on how many cameras have a partner."""
    unit = "of the cameras"
    if len(rig) < 2:
        return [unmeasured("partners", rig.names, unit, *PARTNERED, "one camera alone has nobody to be matched with", "depth needs a second camera, or depth maps of your own")]
    out = [_note(rig, p, max_angle) for p in pairs]
    served = sorted({v for p in pairs if p.kind == "ok" for v in p.views})
    alone = [n for v, n in enumerate(rig.names) if v not in served]
    told = "every camera has a partner to be matched with" if not alone else f"{', '.join(alone)}: no partner within {max_angle:g} degrees that can be rectified, so depth comes from the sweep or the hull there"
    return [measured("partners", (), len(served) / len(rig), unit, *PARTNERED, told, f"set cameras closer together, below {max_angle:g} degrees at the subject; or use depth.method: sweep or hull"), *out]


def _note(rig: Rig, pair: Rectified, max_angle: float) -> Finding:
    names = tuple(rig.names[v] for v in pair.views)
    why = pair.sentence.partition(": ")[2]
    sentence = f"{pair.kind}: {why}; baseline {pair.baseline:.2f} m, {pair.body:.0%} of a body kept"
    grade = Grade.GOOD if pair.kind == "ok" else Grade.NOTE
    return Finding("rectification", names, pair.angle, "degrees", max_angle, max_angle, sentence, "", grade)
