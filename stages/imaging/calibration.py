"""Effect that turns cameras which are written down wrongly by a little: what pairs of them both see says how, and
pictures of left-out source views say whether it is so."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posegaussian.stages.contract.declaration import Decision, Effect, Evidence
from posegaussian.stages.contract.judged import CALIBRATION, MATTES, TURNS, cannot_judge, drawn_at, mean_scores
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.imaging.small_turns import KINDS, LINKS, SIDE, Links, fitted_turns, turned
from posegaussian.storage.model.cameras import Rig

FEWEST = 6
"""Links of a kind below which their median is chance."""
EXPLAINED = {"outlines": 0.9, "features": 0.6}
"""Share of what cameras miss each other by that turns may leave, by the kind that tells. Where they leave more, it is
masks or matches that are wrong. Features alone must be explained better, because wrong ones among few turn cameras,
too: `balance`, 0.52 of 0.60 px left, would have 0.06 dB less on the mean by it, where left-out views had 0.09 and 0.28
more; a person with loose hair, 0.18 of 0.21 px of outlines left, has 0.66 more."""
LEAST_GAIN = 0.05
"""dB by which turns must better the pictures of left-out views. Of cameras that are off by 0.3 px they do by 0.08 to 3,
where held-out pictures gain 0.5 and more; of a head whose masks are a pixel off and whose cameras are not they lose
0.14."""
NEAR = 0.15
"""Px of the pictures that links were found in (see `as_linked`) by which they may miss their lines, of exact cameras
and masks (0.02 to 0.12 at 512 px). Nearer than that they do not tell whether cameras are off; pictures do, which
cameras that are off by 0.1 px cost 0.6 to 0.8 dB."""
SMALLEST = 256
"""Px of the longer side of pictures that can tell so little; in those of 48 px right cameras would be turned."""
ALONE_GAIN = 0.1
"""dB by which turns that pictures alone tell must better those of left-out views. Of people whose cameras are off by
0.1 px they do by 0.12 to 0.6, and held-out pictures gain 0.2 to 0.7, but for one of 38 dB, which loses 0.3; of one
filmed by six cameras by 0.07, and held-out ones lose 0.2. Of right cameras they lose up to 0.10 or gain up to 0.09,
where held-out pictures lose up to 0.29 or gain up to 0.08."""
WORDS = {"outlines": "outermost points of outlines", "features": "matched features"}


def _blind(evidence: Evidence) -> str | None:
    """Why no picture of a left-out view can tell whether turns are right."""
    return cannot_judge(len(evidence.sources), bool(evidence.facts & set(MATTES.values())))


def as_linked(source_rig: Rig) -> Rig:
    """Cameras with pictures of the size that links were found in, `SIDE` px or as captured: by whole px of these masks
    are inexact, and the same bound holds whatever size `frames/*` and the judge's pictures have."""
    return frames_rig(source_rig, round(SIDE))


def told_by(rig: Rig, links: Links) -> tuple[str, float] | None:
    """What tells most of how cameras stand, and the median px by which it misses their lines: outlines, where there are
    some, for features of round things are less exact; None where too few links tell anything."""
    medians = links.medians(rig)
    told = [k for i, k in enumerate(KINDS) if (links.kind == i).sum() >= FEWEST]
    return (told[0], medians[told[0]]) if told else None


def _settled(rig: Rig, links: Links, bound: float, longest: int) -> tuple[float | None, str, bool]:
    """Of the source views as they are written down: median px by which links miss their lines, what is told of it, and
    whether that settles that turns are wrong or useless, as pictures of `longest` px are drawn."""
    told = told_by(rig, links)
    if told is None:
        return None, "no two cameras share enough outlines or features to tell", True
    kind, px = told
    words = f"{WORDS[kind]} miss the lines of other cameras by a median of {px:.2f} px at {rig.size.max()} px"
    if px <= bound:
        return px, words, longest < SMALLEST
    after = links.medians(turned(rig, fitted_turns(rig, links)))
    words += f", {after[kind]:.2f} once these are turned"
    if after[kind] > EXPLAINED[kind] * px:
        return px, f"{words}: that is not what is wrong", True
    return px, words, False


def _calibration(evidence: Evidence, bound: float) -> Decision | None:
    if LINKS not in evidence.noted:
        return None
    sources = list(evidence.sources)
    rig, links = as_linked(evidence.source_rig.subset(sources)), Links.of(evidence.noted[LINKS][:, sources])
    px, told, settled = _settled(rig, links, bound, int(evidence.rig.size[sources].max()))
    if settled:
        return Decision(False, px, bound, told)
    if not {TURNS, CALIBRATION} <= evidence.noted.keys():
        return None
    means = mean_scores(evidence.noted[CALIBRATION])
    if means is None:
        return Decision(False, px, bound, f"{told}; no left-out view could be drawn to tell whether that is right")
    assert px is not None
    return Decision(
        bool(means[1, 0] - means[0, 0] >= (ALONE_GAIN if px <= bound else LEAST_GAIN)),
        px,
        bound,
        f"{told}; left-out source views, drawn from the others, have {drawn_at(means, 1)} with turned cameras,"
        f" {drawn_at(means, 0)} as they are written down",
    )


def _stand(rig: Rig, noted: Mapping[str, np.ndarray]) -> Rig:
    """The source views turned."""
    return turned(rig, noted[TURNS])


CALIBRATION_CORRECTION = Effect(
    "calibration_correction",
    "Turn source views by the little by which their calibration is off.",
    "median distance of what cameras share from each other's lines",
    NEAR,
    "px",
    _calibration,
    asks=(LINKS, TURNS, CALIBRATION),
    stand=_stand,
    uses=(TURNS,),
    lacks=_blind,
)
