"""All findings on one capture, and what its pictures are drawn from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from posegaussian.stages.geometry.sync import TimeOffsets
from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.inspection.cameras import confirmed, of_aim, of_frames, of_lens, of_repeats
from posegaussian.stages.inspection.finding import (
    TO_MEND,
    Finding,
    FindingVerdict,
    left_out,
    overall,
    worst_first,
)
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.inspection.light import of_clipping, of_light
from posegaussian.stages.inspection.matching import Matched, matched_pairs, of_matches
from posegaussian.stages.inspection.outlook import expected, of_cameras, of_matte, pair_lines
from posegaussian.stages.inspection.pairs import Rectified, every_pair, of_pairs
from posegaussian.stages.inspection.people import of_people, of_sight, of_stature, where_looked
from posegaussian.stages.inspection.planned import Planned
from posegaussian.stages.inspection.subject import (
    of_focus,
    of_joints,
    of_masks,
    of_poses,
    of_subjects_mask,
    of_time,
    wrong_masks,
)
from posegaussian.stages.inspection.trust import camera_verdicts, of_trust

WORDS = {
    FindingVerdict.GOOD: "This capture is good: everything that could be measured is within bounds.",
    FindingVerdict.DOUBTFUL: "This capture is doubtful: it can be reconstructed, but what is doubtful will show.",
    FindingVerdict.BAD: "This capture is bad: as it is, a reconstruction will fail or be visibly wrong.",
    FindingVerdict.UNKNOWN: "Nothing of this capture could be measured.",
}


@dataclass(frozen=True, eq=False)
class Report:
    """What an inspection found."""

    findings: tuple[Finding, ...]
    """All, in the order in which they were measured."""
    pairs: tuple[Rectified, ...]
    """What each pair is good for."""
    matches: tuple[Matched, ...]
    """Matched features of the pairs that were compared."""
    offsets: TimeOffsets | None
    """How far cameras are out of step; None without joints of two cameras."""
    planned: Planned
    """What a run will make of the capture, of the believed cameras."""
    footage: Footage
    """What was looked at, which of its cameras are believed, and all of them as they stand."""
    turned: tuple[str, ...] = ()
    """Names of the cameras that a run turns by itself."""

    @property
    def verdict(self) -> FindingVerdict:
        """The worst of all that count: cameras that a run leaves out by itself do not."""
        return overall(self.findings)

    @property
    def left_out(self) -> str:
        """Names of the cameras that a run leaves out by itself, one after the other."""
        return ", ".join(self.footage.names[v] for v in self.footage.left_out)

    @property
    def sentence(self) -> str:
        """The verdict in one sentence, with what it is about, and whom it is not about."""
        faults = dict.fromkeys(f.measure for f in worst_first(self.findings) if f.verdict is self.verdict)
        about = f" ({', '.join(faults)})" if self.verdict in (FindingVerdict.BAD, FindingVerdict.DOUBTFUL) else ""
        head, _, tail = WORDS[self.verdict].partition(":")
        gone = f" A run leaves out {self.left_out}, not counted here." if self.left_out else ""
        return (f"{head}{about}:{tail}" if tail else head) + gone

    @property
    def unmeasured(self) -> list[str]:
        """What could not be measured of anybody, and why."""
        known = {f.measure for f in self.findings if f.verdict is not FindingVerdict.UNKNOWN}
        return [
            f"{m}: {why}" for m, why in {f.measure: f.sentence for f in self.findings if f.measure not in known}.items()
        ]

    @property
    def to_do(self) -> list[tuple[FindingVerdict, str, str]]:
        """(verdict, what was found, what to do), the most useful first;
        findings with the same advice stand together, those on cameras that are left out apart."""
        out: dict[tuple[str, str, bool], tuple[FindingVerdict, list[Finding]]] = {}
        for f in worst_first(self.findings):
            if f.advice and f.verdict in TO_MEND:
                key = f.measure, f.advice, f.verdict is FindingVerdict.LEFT_OUT
                out.setdefault(key, (f.verdict, []))[1].append(f)
        return [
            (verdict, "; ".join(f"{f.about}: {f.sentence}" for f in same), advice)
            for (_, advice, _), (verdict, same) in out.items()
        ]

    @property
    def outlook(self) -> list[str]:
        """What a run will do, and what to expect of it, a sentence a line."""
        spoken = {f.measure: f for f in self.findings if f.measure in ("matte", "people")}
        estimator, why = self.planned.estimator
        return [
            *where_looked(self.footage),
            *([f"run leaves out {self.left_out}: see agreement; views.trust overrules it"] if self.left_out else []),
            *([f"run turns {', '.join(self.turned)}: see agreement; views.trust overrules it"] if self.turned else []),
            *pair_lines(self.planned),
            f"joints: detection.estimator comes to {estimator}, because {why}",
            f"mattes: {spoken['matte'].sentence}",
            f"people: {spoken['people'].sentence}",
            expected(self.planned, self.findings),
            *([self.planned.left_out] if self.planned.left_out else []),
        ]


def inspect(footage: Footage, sizes: list[Finding], planned: Planned) -> Report:
    """Measure everything; `sizes` are the findings on picture sizes,
    `planned` is what a run will make of the capture.

    A camera that a run leaves out by itself is compared with the believed ones, and nothing with it; one that a run
    turns is measured as it stands then.
    """
    verdicts = camera_verdicts(footage, planned)
    gone = {name for name, v in verdicts.items() if v.state == "left out"}
    turns = {name: v.turn for name, v in verdicts.items() if v.turn.any()}
    footage = footage.without(sorted(gone)).standing(turns)
    of_view = np.array([turns.get(name, np.zeros(3)) for name in planned.rig.names])
    planned = replace(
        planned,
        rig=turned(planned.rig, of_view),
        sources=tuple(v for v in planned.sources if planned.rig.names[v] not in gone),
    )
    pairs = every_pair(planned)
    found = matched_pairs(footage, pairs)
    time, offsets = of_time(footage)
    measured = [
        *sizes,
        *_of_calibration(footage),
        *of_matches(footage, pairs, found),
        *of_joints(footage),
        *of_poses(footage),
        *(own := of_subjects_mask(footage)),
        *of_masks(footage, planned, wrong_masks(own)),
        *of_trust(verdicts),
        *time,
        *of_light(footage),
        *of_clipping(footage),
        *of_focus(footage),
        *of_sight(footage),
        *of_people(footage, planned),
        *of_stature(footage),
        of_matte(planned),
        of_cameras(planned),
        *of_pairs(planned, pairs),
    ]
    findings = [left_out(f) if gone.intersection(f.cameras) else f for f in confirmed(measured)]
    return Report(tuple(findings), tuple(pairs), tuple(found), offsets, planned, footage, tuple(turns))


def _of_calibration(footage: Footage) -> Iterator[Finding]:
    """What needs no picture, or its file alone."""
    yield from of_frames(footage.names, footage.numbers, footage.believed)
    yield from of_repeats(footage)
    for v in range(len(footage.rig)):
        yield from of_lens(footage.source_rig, v)
    yield from of_aim(footage.source_rig, footage.believed)
