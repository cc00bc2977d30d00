"""What is said of a view of which the network says hardly anything, or whose pairs it was not shown."""

from __future__ import annotations

from collections.abc import Sequence

from posegaussian.stages.geometry.pairs import SAME_BODY, PairReport, PairVerdict, pair_report
from posegaussian.stages.geometry.rectification import STRETCH
from posegaussian.storage.model.cameras import Rig

SURE = 0.1
"""Mean confidence on the surface below which a view is reported: the network hardly says anything there."""

ANALYTIC = "its analytic depth stands"


def notes(
    rig: Rig, sources: Sequence[int], view: int, widest: float, confidence: float, left_out: int
) -> tuple[str, ...]:
    """Sentences about one of the source views, none where all is well.

    `confidence` is the mean on its surface, `left_out` so many of its pairs as took too large pictures, of all frames
    together; pairs stand `widest` degrees apart at most.
    """
    reports = [r for r in pair_report(rig, sources, widest) if view in r.views]
    large = (_too_large(reports, left_out),) if left_out else ()
    if confidence >= SURE:
        return large
    if reports and not any(r.usable for r in reports):
        return (*large, f"the network was shown no pair of this view, {_refused(reports, widest)}: {ANALYTIC}")
    return (*large, f"the network's mean confidence is {confidence:.2f} (at least {SURE:g} expected): {ANALYTIC}")


def _too_large(reports: Sequence[PairReport], left_out: int) -> str:
    """Why so many pairs of a view were not looked at."""
    close_up = any(r.usable and min(r.shares) < SAME_BODY for r in reports)
    why = (
        "one of the two cameras shows a part of the person only, enlarged"
        if close_up
        else "look for parts of the masks at the rim that are no person"
    )
    return (
        f"{left_out} of its pairs in these frames were not shown to the network: rectified, what the masks hold takes"
        f" more than {STRETCH:g} pictures; {why}"
    )


def _refused(reports: Sequence[PairReport], widest: float) -> str:
    """Why no pair of a view is usable: its narrowest one."""
    nearest = min(reports, key=lambda r: r.angle)
    if nearest.verdict is PairVerdict.TOO_WIDE:
        return f"no other camera stands within {widest:g} degrees of it"
    return f"the nearest camera cannot be compared ({nearest.sentence})"
