"""When matches are checked from the other side: where one view of a pair sees what the other cannot. When limbs
bound the search: where joints fit the pictures."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.declaration import Decision, Effect, Evidence
from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D
from posegaussian.stages.depth import facts
from posegaussian.stages.depth.params import resolve_method
from posegaussian.stages.geometry.subject import PERSON_RADIUS, look_at_point


def hidden_width(evidence: Evidence) -> float:
    """Measure in px of `frames/*`: how wide a strip behind an arm one view sees and its partner does not, in the widest
    pair used.

    A surface a body's radius in front of another shifts against it by f B (1/z - 1/(z + r)) between two pictures; what
    it uncovers in one of them is that wide. f in px, B the baseline of a view and one of its `pairs` nearest neighbours
    within
    `max_angle` degrees at the point the cameras look at, z its distance.
    """
    rig = evidence.rig.subset(evidence.sources)
    centre = look_at_point(rig)
    rays = rig.centres - centre
    distance = np.linalg.norm(rays, axis=1)
    cosine = np.clip((rays @ rays.T) / np.outer(distance, distance), -1.0, 1.0)
    angle = np.rad2deg(np.arccos(cosine)) + np.diag(np.full(len(rig), np.inf))
    widest = 0.0
    for v in range(len(rig)):
        partners = [
            w
            for w in np.argsort(angle[v], kind="stable")[: evidence.params.pairs]
            if angle[v, w] <= evidence.params.max_angle
        ]
        focal = float(np.sqrt(rig.intrinsics[v, 0, 0] * rig.intrinsics[v, 1, 1]))
        shift = focal * (1.0 / distance[v] - 1.0 / (distance[v] + PERSON_RADIUS))
        widest = max([widest, *(shift * float(np.linalg.norm(rig.centres[v] - rig.centres[w])) for w in partners)])
    return float(widest)


def _nothing_matched(evidence: Evidence) -> str | None:
    if len(evidence.sources) < 2:
        return "there is a single source view: nothing is matched"
    method = resolve_method(evidence.params, evidence.facts)
    return None if method.matches else f"depth.method is {method.name}: nothing is matched"


def _check(evidence: Evidence, bound: float) -> Decision:
    width = hidden_width(evidence)
    if not width:
        return Decision(
            False,
            0.0,
            bound,
            f"no two source views are within {evidence.params.max_angle:g} degrees (depth.max_angle): nothing is"
            " matched",
        )
    return Decision(
        bool(width > bound),
        width,
        bound,
        f"behind an arm, a view sees strips of up to {width:.1f} px that its partner does not",
    )


LEFT_RIGHT_CHECK = Effect(
    facts.LEFT_RIGHT_CHECK,
    "Drop matches that the other view of the pair contradicts.",
    "widest strip hidden from one view of a pair",
    # Low on purpose: with cameras 4 degrees apart (0.4 px hidden, 48 px pictures) the check still takes a fifth of the
    # error away.
    0.1,
    "px",
    _check,
    lacks=_nothing_matched,
)


FEWEST = 8
"""Joints a view and frame, of 17, that must be triangulated on average: with fewer there are hardly any limbs."""


def _trusted_joints(evidence: Evidence, bound: float) -> Decision | None:
    if JOINTS2D not in evidence.facts:
        return Decision(False, None, bound, "joints came in 3D alone: nothing tells how well they fit the pictures")
    if "survey/joint_fit" not in evidence.noted:
        return None
    distance, share, compared = joints_that_fit(evidence.noted["survey/joint_fit"])
    if share is None:
        return Decision(
            False,
            None,
            bound,
            f"{compared:.1f} joints a view and frame are triangulated, too few for limbs ({FEWEST} needed)",
        )
    return Decision(
        bool(share > bound),
        share,
        bound,
        f"joints lie {distance:.2%} of the longer side from the triangulated ones, {share:.0%} of them within 1.5 %",
    )


def _no_limbs(evidence: Evidence) -> str | None:
    if len(evidence.sources) < 2:
        return "there is a single source view: no search that limbs could bound"
    method = resolve_method(evidence.params, evidence.facts)
    if not method.several:
        return f"depth.method is {method.name}: nothing is searched"
    return None if {JOINTS2D, JOINTS3D} & evidence.facts else "the capture has no joints"


def joints_that_fit(fit: np.ndarray) -> tuple[float, float | None, float]:
    """From `survey/joint_fit` [S, 3]: the joints' distance from the triangulated ones, as a share of the longer side,
    the share of them that is close, None where too few were triangulated, and how many a view and frame were."""
    distances, shares, compared = fit.T
    weights = compared / max(compared.sum(), 1e-9)
    share = float(shares @ weights) if compared.mean() >= FEWEST else None
    return float(distances @ weights), share, float(compared.mean())


LIMB_BOUNDS = Effect(
    facts.LIMB_BOUNDS,
    "Search for the surface no farther in front of the limbs than cloth reaches, where the hull has phantoms. A view"
    " that is compared with at most one other within 66 degrees is searched no farther behind their bones either, and"
    " what was not matched there lies on the limb that it shows; so does all of a view that none is compared with.",
    "share of the joints within 1.5 % of the picture's longer side from the triangulated ones",
    # Above a half means a median distance below 1.5 %, 7.7 px at 512.
    0.5,
    "1",
    _trusted_joints,
    asks=("survey/joint_fit",),
    lacks=_no_limbs,
)
