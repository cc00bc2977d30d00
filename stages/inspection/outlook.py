"""What to expect of a run: cameras, mattes, and a tier with the figures that were measured for such a geometry
(docs/measurements/quality.md, docs/measurements/mattes.md)."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D, SEGMENTED
from posegaussian.stages.estimators.blazepose_files import FETCH
from posegaussian.stages.geometry.pairs import PairVerdict
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, measured
from posegaussian.stages.inspection.people import SIGHT
from posegaussian.stages.inspection.planned import Planned

MATTE = (0.93, 0.5)
"""Overlap of a matte with outlines drawn by hand: from .94 on only edges are off;
at half of it there is another shape."""
OVERLAPS = {"segmented": (0.94, 0.97), "person": (0.84, 0.97), "plate": (0.72, 0.91), "none": (0.0, 0.1)}
"""Least and largest overlap that was measured for each matte on other captures, `docs/measurements/mattes.md`: the
person with an estimator's segmentation and by joints alone, and a background plate; where everything is foreground, a
person fills a tenth of it, about."""
RING = ((22.5, 32.1, 0.972), (45.0, 28.3, 0.934), (60.0, 26.7, 0.911))
"""Degrees between neighbours; PSNR in dB and SSIM in the person's box, by `sweep`: simulated people, exact cameras
and masks, all around."""
HULL = ((22.5, 30.5), (45.0, 23.7), (60.0, 20.8))
"""The same of the hull alone, dB."""
TIERS = ("sharp", "good", "fair", "poor", "not fit to be shown")
"""From sixteen cameras around to what cannot be looked at."""
TIER_ANGLES = (25.0, 50.0, 75.0)
"""Degrees between neighbours up to which the first three can be had."""
CAMERAS = (5.0, -inf)
"""Source cameras from which on a hull can close behind the subject. Fewer are never bad by themselves, but at best
fair: in simulation two cameras 9 degrees apart come to what six that are 60 degrees apart reach."""
COSTS = {
    "epipolar distance": "calibrations that are 0.3 to 1 px off cost 0.7 to 3.9 dB",
    "calibration by joints": "calibrations that are 0.3 to 1 px off cost 0.7 to 3.9 dB",
    "mask agreement": (
        "masks that are a pixel off cost 0.3 dB; cameras that stand elsewhere than their calibration says cost 5.6 dB"
        " on a real capture"
    ),
    "mask at the rim": "masks do not cut the subject out",
    "joints on masks": "masks are not the subject's",
    SIGHT: "a camera in which nobody is found adds little",
    "matte": "mattes are not those of the figures",
    "partners": "cameras without a partner show the hull alone",
    "time offset": "cameras out of step blur what moves",
    "joint residual": "joints and cameras do not fit each other",
    "people": "a second person hides the subject or leaves pieces",
    "exposure": "cameras that differ leave seams",
    "clipped white": "what is clipped has lost its colour",
    "focus": "blurred pictures stay blurred",
    "blur against others": "blurred pictures stay blurred",
    "repeated pictures": "a camera that stands still contradicts the others",
    "frames": "frames that a camera lacks are made without it",
}
"""What a doubtful measure does to the pictures; figures from docs/measurements/quality.md."""


def of_cameras(planned: Planned) -> Finding:
    """How many source cameras there are."""
    count = len(planned.sources)
    told = f"{count} source camera{'s' if count > 1 else ''}" + (
        "" if count >= CAMERAS[0] else ": no hull closes behind the subject, and what no two of them see is guessed"
    )
    return measured(
        "cameras",
        (),
        count,
        "sources",
        *CAMERAS,
        told,
        "more cameras, beside those that are there; until then keep to paths near them (between, arc, sway)",
    )


def of_matte(planned: Planned) -> Finding:
    """What `frames.matte` takes, with how well that fits outlines elsewhere."""
    matte, why = planned.matte
    if matte == "given":
        return Finding(
            "matte", (), 1.0, "as given", 0, 0, f"frames.matte: given, because {why}", "", FindingVerdict.NOTE
        )
    low, high = OVERLAPS["segmented" if matte == "person" and SEGMENTED in planned.facts else matte]
    told = (
        f"frames.matte: {matte}, because {why}; on other captures {low:.2f} to {high:.2f} overlap with outlines by hand"
    )
    return measured("matte", (), (low + high) / 2, "overlap on other captures", *MATTE, told, _better(planned))


def _better(planned: Planned) -> str:
    """How to come to better mattes, the easiest first."""
    if {JOINTS2D, JOINTS3D} & planned.facts and planned.matte[0] != "person":
        return f"set frames.matte: person, which cuts the person out by the joints that are here; better with `{FETCH}`"
    return f"`{FETCH}`: BlazePose finds the person and cuts the outline; or import masks with the capture"


def pair_lines(planned: Planned) -> list[str]:
    """Which pairs a run matches, and why not the others, reason by reason."""
    if not planned.matches:
        return [f"depth comes from {planned.depth.method}: no pictures are compared with each other"]
    angles = {tuple(sorted(r.views)): r.angle for r in planned.source_reports}
    pairs = sorted(planned.matched, key=lambda p: angles[p])
    named = ", ".join(
        f"{planned.rig.names[a]} and {planned.rig.names[b]} ({angles[a, b]:.0f} degrees apart)" for a, b in pairs[:12]
    )
    more = f" and {len(pairs) - 12} more" if len(pairs) > 12 else ""
    out = [
        (
            f"run matches {len(pairs)} of {len(planned.source_reports)} pairs ({planned.depth.method}): {named}{more}"
            if pairs
            else f"run matches none of {len(planned.source_reports)} pairs"
        )
    ]
    for reason in PairVerdict:
        same = sorted((r for r in planned.refused if r.verdict is reason), key=lambda r: r.angle)
        if same:
            pair, _, why = same[0].sentence.partition(": ")
            out.append(
                f"run refuses {len(same)} {'pair' if len(same) == 1 else 'pairs'},"
                f" {reason}{'; the nearest' if len(same) > 1 else ''}: {pair} ({same[0].angle:.0f} degrees apart),"
                f" {why.partition(', ')[2]}"
            )
    idle = len(planned.source_reports) - len(pairs) - len(planned.refused)
    if idle:
        pairs_word = "pair" if idle == 1 else "pairs"
        out.append(
            f"run leaves {idle} usable {pairs_word} out: nearer partners are there (depth.pairs: {planned.depth.pairs})"
        )
    return out


def tier(planned: Planned, findings: Sequence[Finding]) -> str:
    """One of `TIERS`: what neighbours so far apart allow, a step less for a doubtful matte and for anything else
    that is doubtful, the last where anything is bad."""
    if any(f.verdict is FindingVerdict.BAD for f in findings):
        return TIERS[-1]
    if planned.gap is None:
        return TIERS[3]
    step = int(np.searchsorted(TIER_ANGLES, planned.gap))
    step = max(step, 2) if len(planned.sources) < CAMERAS[0] else step
    doubtful = {f.measure for f in _lowering(planned, findings)}
    return TIERS[min(3, step + ("matte" in doubtful) + bool(doubtful - {"matte"}))]


def _lowering(planned: Planned, findings: Sequence[Finding]) -> list[Finding]:
    """Findings that lower the pictures; a second person does not where a matte cuts out one."""
    cut = planned.matte[0] in ("given", "person")
    return [
        f
        for f in findings
        if f.verdict in (FindingVerdict.BAD, FindingVerdict.DOUBTFUL)
        and f.measure in COSTS
        and not (cut and f.measure == "people")
    ]


def _untold(findings: Sequence[Finding]) -> str:
    """That nothing is known of the cameras' timing, which would lower the pictures; empty where some of it is."""
    verdicts = {f.verdict for f in findings if f.measure == "time offset"}
    return "; whether the cameras are in step was not measured" if verdicts == {FindingVerdict.UNKNOWN} else ""


def expected(planned: Planned, findings: Sequence[Finding]) -> str:
    """The tier in one sentence, with the figures of such a geometry and what lowers them here."""
    verdict = tier(planned, findings)
    if any(f.measure == SIGHT and f.verdict is FindingVerdict.BAD for f in findings):
        return "expected: nothing, as nobody was found in any picture that was looked at"
    if not planned.matches:
        return (
            f"expected: not measured for depth.method {planned.depth.method} and {len(planned.sources)} source"
            f" camera{'s' if len(planned.sources) > 1 else ''}; a single view: docs/guide/monocular.md"
        )
    lowered = dict.fromkeys(COSTS[f.measure] for f in _lowering(planned, findings))
    less = (f"; less here: {'; '.join(lowered)}" if lowered else "") + _untold(findings)
    if planned.gap is None:
        hull = (
            f"with the cameras all around, 45 to 60 degrees apart, it reached {HULL[1][1]:g} to {HULL[2][1]:g} dB in"
            " simulation, less with fewer"
        )
        return f"expected: {verdict}; no pair is matched, so all depth is the hull of the masks: {hull}{less}"
    widest, (angles, psnr, ssim) = planned.gap, zip(*RING, strict=True)
    reached = (
        f"at most {RING[0][1]:g} dB (SSIM {RING[0][2]:.2f})"
        if widest <= angles[0]
        else (
            f"{np.interp(widest, angles, psnr):.1f} dB (SSIM {np.interp(widest, angles, ssim):.2f})"
            if widest <= angles[-1]
            else f"less than {RING[-1][1]:g} dB"
        )
    )
    where = (
        "near the cameras"
        if planned.stretch is None
        else (
            "all around"
            if planned.stretch.closed
            else (
                f"between {planned.rig.names[planned.stretch.views[0]]} and"
                f" {planned.rig.names[planned.stretch.views[-1]]}, {planned.stretch.span:.0f} of 360 degrees; elsewhere"
                " less"
            )
        )
    )
    return (
        f"expected: {verdict}, {where}; simulated people with exact cameras and masks, all around and neighbours"
        f" {widest:.0f} degrees apart, reach {reached} in their box at 512 px{less}"
    )
