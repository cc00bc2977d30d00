"""What an inspection says: a number, its bounds, a verdict and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import isinf


class FindingVerdict(StrEnum):
    """What a number means for a reconstruction."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    BAD = "bad"
    UNKNOWN = "unknown"
    NOTE = "note"
    """Neither good nor bad by itself: what counts is the whole."""
    LEFT_OUT = "left out"
    """Beyond its bounds, but of a camera that a run leaves out by itself: it does not count."""


ORDER = (
    FindingVerdict.BAD,
    FindingVerdict.DOUBTFUL,
    FindingVerdict.LEFT_OUT,
    FindingVerdict.UNKNOWN,
    FindingVerdict.NOTE,
    FindingVerdict.GOOD,
)
"""Worst first; what could not be measured before what is good."""
IMPACT = (
    "picture size",
    "frames",
    "repeated pictures",
    "somebody in sight",
    "aim",
    "agreement",
    "time offset",
    "mask at the rim",
    "joints on masks",
    "mask agreement",
    "calibration by joints",
    "joint residual",
    "epipolar distance",
    "matte",
    "people",
    "stature",
    "partners",
    "neighbours",
    "cameras",
    "exposure",
    "clipped white",
    "blur against others",
    "focus",
    "lens model",
    "lens distortion",
    "principal point",
    "focal lengths",
)
"""Measures in the order in which to mend them:
what makes all others wrong first, then what spoils most of the picture."""
TO_MEND = ORDER[:3]
"""Verdicts that come with advice."""
COUNTED = (FindingVerdict.BAD, FindingVerdict.DOUBTFUL, FindingVerdict.GOOD)
"""Verdicts that the capture's own follows from."""


@dataclass(frozen=True)
class Finding:
    """One measure of one camera, one pair, or the whole capture."""

    measure: str
    """What was measured, a few words; findings of one measure share it."""
    cameras: tuple[str, ...]
    """Whom it is about; empty for the whole capture."""
    value: float | None
    """The number; None where it cannot be measured."""
    unit: str
    """Its unit."""
    good: float
    """Good up to this value; from this value on where `good` is above `bad`."""
    bad: float
    """Bad beyond this value; never where it is infinite."""
    sentence: str
    """What was found, or why nothing could be."""
    advice: str
    """What to do about it; empty where nothing needs doing."""
    verdict: FindingVerdict
    at_least: bool = False
    """Whether the number is a bound that the true value may lie above."""

    @property
    def about(self) -> str:
        """Whom it is about, in words."""
        return " and ".join(self.cameras) if self.cameras else "capture"

    @property
    def excess(self) -> float:
        """How far beyond its bounds, 1 at the bad one: what is worst is told first."""
        if self.value is None or self.good == self.bad:
            return 0.0
        return (self.value - self.good) / (self.bad - self.good)

    @property
    def number(self) -> str:
        """Value with unit."""
        if self.value is None:
            return "-"
        return f"{'at least ' if self.at_least and self.value else ''}{self.value:.3g} {self.unit}".strip()

    @property
    def bounds(self) -> str:
        """Bounds in words; empty where there are none."""
        if self.good == self.bad:
            return f"at most {self.good:g}" if self.good else ""
        beyond = ("at most", "above") if self.good <= self.bad else ("at least", "below")
        bad = "never bad" if isinf(self.bad) else f"bad {beyond[1]} {self.bad:g}"
        return f"good {beyond[0]} {self.good:g}, {bad}"


def graded(value: float, good: float, bad: float) -> FindingVerdict:
    """The verdict on a value: small is good where `good` <= `bad`, else large is."""
    sign = 1.0 if good <= bad else -1.0
    if sign * value <= sign * good:
        return FindingVerdict.GOOD
    return FindingVerdict.BAD if sign * value > sign * bad else FindingVerdict.DOUBTFUL


def measured(
    measure: str,
    cameras: Sequence[str],
    value: float,
    unit: str,
    good: float,
    bad: float,
    sentence: str,
    advice: str,
    at_least: bool = False,
) -> Finding:
    """A finding whose verdict follows from the bounds; the advice is left out where all is good."""
    verdict = graded(value, good, bad)
    return Finding(
        measure,
        tuple(cameras),
        float(value),
        unit,
        good,
        bad,
        sentence,
        "" if verdict is FindingVerdict.GOOD else advice,
        verdict,
        at_least,
    )


def unmeasured(
    measure: str, cameras: Sequence[str], unit: str, good: float, bad: float, why: str, advice: str = ""
) -> Finding:
    """A finding without a number."""
    return Finding(measure, tuple(cameras), None, unit, good, bad, why, advice, FindingVerdict.UNKNOWN)


def left_out(finding: Finding) -> Finding:
    """The same of a camera that a run leaves out: what is wrong with it is told, and does not count."""
    counts = finding.verdict in (FindingVerdict.BAD, FindingVerdict.DOUBTFUL)
    return replace(finding, verdict=FindingVerdict.LEFT_OUT) if counts else finding


def worst_first(findings: Sequence[Finding]) -> list[Finding]:
    """By verdict, then the cause before what follows from it, then by how far a value is beyond its bounds."""
    return sorted(findings, key=lambda f: (ORDER.index(f.verdict), _impact(f.measure), -f.excess))


def _impact(measure: str) -> int:
    """The measure's place in the order in which to mend them."""
    return IMPACT.index(measure) if measure in IMPACT else len(IMPACT)


def by_measure(findings: Sequence[Finding]) -> list[Finding]:
    """All findings of one measure together, the measure with the worst one first, and within it worst first."""
    ordered = worst_first(findings)
    places = {m: i for i, m in enumerate(dict.fromkeys(f.measure for f in ordered))}
    return sorted(ordered, key=lambda f: places[f.measure])


def overall(findings: Sequence[Finding]) -> FindingVerdict:
    """The worst verdict of all that could be measured and counts; unknown where nothing could."""
    known = [f.verdict for f in findings if f.verdict in COUNTED]
    return min(known, key=ORDER.index) if known else FindingVerdict.UNKNOWN
