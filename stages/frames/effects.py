"""What the frames stage computes only where it is called for: undistortion, crop and scale, exposure matching."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.declaration import Decision, Effect, Evidence
from posegaussian.stages.contract.facts import JOINTS2D, LINEAR_LIGHT, MASKS, SEVERAL_FRAMES
from posegaussian.stages.contract.judged import (
    EXPOSURE,
    PERSON_MATTE,
    PLATE_MATTE,
    SHARED_LIGHT,
    drawn_at,
    may_judge,
    mean_scores,
)
from posegaussian.stages.depth.effects import joints_that_fit
from posegaussian.stages.frames import facts
from posegaussian.stages.frames.exposures import SURFACE, compared, points_in, side_by_side
from posegaussian.stages.imaging import exposure
from posegaussian.stages.imaging.noise import noise_at, size_worked_at
from posegaussian.stages.imaging.steady_light import CHANGES, UNTOLD

OUTLINES, SLOPES = "survey/outlines", "survey/slopes"
LIGHT, UNREST, DRIFT = "survey/light", "survey/unrest", "survey/drift"
GAPS, JOINT_FIT = "survey/gaps", "survey/joint_fit"
"""What the survey measures for them."""
NO_LINK = f"no two cameras share {exposure.FEWEST_POINTS} well exposed surface points, dark and bright ones"
"""Why gains cannot be told."""
FEWEST_POINTS = 200
"""Points of an outline, over a few pictures, below which its offset is chance."""
LEAST_GAIN = 0.0
"""dB by which gains must better the pictures of left-out views, where more than the bound is proven."""
LIKELY, CLEAR_GAIN = 0.5, 0.03
"""Share of the bound that suffices where gains better these pictures by so many dB. Cameras that are alike, people like
captures, 512 px: on none of eleven scenes whose surface seems to differ by more than the bound do gains draw better,
-0.01 to -0.78 dB. Cameras that differ by a third of a stop: with 0.20 stops proven they draw +0.05 and +0.11 dB, and
finished pictures gain 0.48 and 0.23; with none proven +0.04, and finished ones lose 0.28."""
DOUBTFUL = 0.5
"""Share of the body that may look like the backdrop, over the share of the masks that is taken for it."""
BELIEVED = 0.5
"""Share of the joints that must fit the triangulated ones: what BlazePose finds in a marble head is no body."""
FAINT = 2.0
"""1/255 a px: outlines across which colours change by less have no edge that could be followed."""
SCATTERED = 2.0
"""Interquartile range, captured px, above which a view's edges tell nothing:
clutter beside the subject, or no edge at all."""


def _single_view(evidence: Evidence) -> str | None:
    """Why exposures cannot be compared."""
    return "there is a single source view" if len(evidence.sources) < 2 else None


def _settled_by_features(evidence: Evidence, bound: float) -> Decision | None:
    """Off, where features that cameras share are as bright in all of them, gloss and all; and where there are none and
    no two views stand near enough to see the same surface."""
    if SURFACE not in evidence.noted:
        return None
    found = exposure.match(evidence.noted[SURFACE][:, list(evidence.sources)])
    if found is None:
        near = side_by_side(evidence.rig, evidence.sources)
        return None if near else Decision(False, None, bound, NO_LINK)
    if found.apart.max() > bound:
        return None
    return Decision(
        False, 0.0, bound, f"on surfaces that cameras share, none differ by more than {found.apart.max():.2f} stops"
    )


def _exposure(evidence: Evidence, bound: float) -> Decision | None:
    judged = may_judge(evidence.facts)
    if judged and (settled := _settled_by_features(evidence, bound)) is not None:
        return settled
    if not {compared(evidence.facts), *([EXPOSURE] if judged else [])} <= evidence.noted.keys():
        return None
    found = exposure.match(points_in(evidence))
    if found is None:
        return Decision(False, None, bound, NO_LINK)
    pair = np.unravel_index(int(found.certain.argmax()), found.certain.shape)
    proven = float(found.certain[pair])
    if proven == 0:
        return Decision(
            False, 0.0, bound, "on surfaces that cameras share, no difference is beyond the error of the measure"
        )
    first, second = (evidence.source_rig.names[evidence.sources[i]] for i in pair)
    told = (
        f"on surfaces that cameras share, {first} and {second} differ by {found.apart[pair]:.2f} stops, at least"
        f" {proven:.2f} of them for certain"
    )
    means = mean_scores(evidence.noted[EXPOSURE]) if judged and proven > LIKELY * bound else None
    if means is None:
        return Decision(bool(proven > bound), proven, bound, told)
    better = float(means[1, 0] - means[0, 0])
    on, so = better >= (LEAST_GAIN if proven > bound else CLEAR_GAIN), ""
    if proven <= bound and on:
        so = f", so {LIKELY * bound:g} stops suffice"
    return Decision(
        on,
        proven,
        bound,
        f"{told}; left-out source views, drawn from the others, have {drawn_at(means, 1)} with gains,"
        f" {drawn_at(means, 0)} without{so}",
    )


def proven_offsets(outlines: np.ndarray) -> np.ndarray:
    """[S] captured px by which the outlines of S views lie outside the pictures' edges, from `survey/outlines` [S,
    3]; 0 where that cannot be told."""
    offset, scatter, points = outlines.T
    return np.where((points >= FEWEST_POINTS) & (scatter <= SCATTERED), offset, 0.0)


def _no_outlines(evidence: Evidence) -> str | None:
    """Why outlines cannot be compared with edges."""
    if evidence.params.matte not in ("auto", "given"):
        return f"frames.matte is {evidence.params.matte}: no mask is given"
    return None if MASKS in evidence.facts else "the capture came without masks"


def _ragged(evidence: Evidence, bound: float) -> Decision | None:
    if SLOPES not in evidence.noted:
        return None
    given, redrawn = evidence.noted[SLOPES].T
    told = redrawn >= FAINT
    if not told.any():
        return Decision(False, None, bound, "no view's pictures have clear edges along the masks' outlines")
    missed = float(np.median(1 - np.minimum(given[told] / redrawn[told], 1)))
    return Decision(
        missed > bound,
        missed,
        bound,
        f"pictures change across the outlines of masks by {missed:.0%} less than across edges beside these (median of"
        f" {told.sum()} views)",
    )


def _outlines(evidence: Evidence, bound: float) -> Decision | None:
    if OUTLINES not in evidence.noted:
        return None
    if facts.OUTLINE_REDRAWING in evidence.facts:
        return Decision(False, None, bound, "outlines are redrawn (outline_redrawing); that moves them, too")
    sources = list(evidence.sources)
    sizes = size_worked_at(evidence.rig, evidence.source_rig, evidence.captured_to_calibrated)[sources]
    offsets = proven_offsets(evidence.noted[OUTLINES]) * sizes
    worst = int(np.abs(offsets).argmax())
    off, name = float(offsets[worst]), evidence.rig.names[sources[worst]]
    if off == 0:
        return Decision(False, 0.0, bound, "no view's pictures have clear edges along the masks' outlines")
    return Decision(
        bool(abs(off) > bound),
        abs(off),
        bound,
        f"the masks of {name} end {abs(off):.2f} px {'outside' if off > 0 else 'inside'} the subject's edge",
    )


def proven_gaps(gaps: np.ndarray) -> np.ndarray:
    """[S] share of the masks of S views that shows the backdrop, from `survey/gaps` [S, 2]; 0 where as much of the body
    might."""
    shares, doubts = gaps.T
    return np.where(doubts <= DOUBTFUL * shares, shares, 0.0)


def _no_gaps(evidence: Evidence) -> str | None:
    """Why nothing tells gaps of a mask from the body."""
    if (lacking := _no_outlines(evidence)) is not None:
        return lacking
    return None if JOINTS2D in evidence.facts else "no joints tell where the body is"


def _gaps(evidence: Evidence, bound: float) -> Decision | None:
    if not {GAPS, JOINT_FIT} <= evidence.noted.keys():
        return None
    _, fitting, compared = joints_that_fit(evidence.noted[JOINT_FIT])
    if fitting is None or fitting <= BELIEVED:
        told = "too few for a body" if fitting is None else f"{fitting:.0%} of them within 1.5 % of the longer side"
        return Decision(False, None, bound, f"{compared:.1f} joints a view and frame are triangulated, {told}")
    proven = proven_gaps(evidence.noted[GAPS])
    worst = int(proven.argmax())
    share, name = float(proven[worst]), evidence.rig.names[evidence.sources[worst]]
    told = f"{share:.1%} of the masks of {name} lie beside the body and look like the backdrop around them"
    return Decision(share > bound, share, bound, told)


def _no_light(evidence: Evidence) -> str | None:
    """Why nothing can lie beyond white."""
    return None if LINEAR_LIGHT in evidence.facts else "the pictures are display-referred: no source view came as EXR"


def _beyond_white(evidence: Evidence, bound: float) -> Decision | None:
    if LIGHT not in evidence.noted:
        return None
    shares = evidence.noted[LIGHT][:, 0]
    worst = int(shares.argmax())
    share, name = float(shares[worst]), evidence.rig.names[evidence.sources[worst]]
    return Decision(bool(share > bound), share, bound, f"{share:.2%} of the light of {name} lies beyond white")


def white_point(light: np.ndarray) -> float:
    """Linear light that becomes white, from `survey/light` [S, 2]: the brightest of the source views, at least 1."""
    return max(1.0, float(light[:, 1].max()))


def _no_still_background(evidence: Evidence) -> str | None:
    """Why light over time cannot be told."""
    if SEVERAL_FRAMES not in evidence.facts:
        return "the capture has a single frame"
    if LINEAR_LIGHT in evidence.facts:
        return "the pictures are linear light"
    if not evidence.facts & {PERSON_MATTE, PLATE_MATTE}:
        return "no background plate is made: masks are given, or everything is foreground"
    return None


def _drift(evidence: Evidence, bound: float) -> Decision | None:
    if DRIFT not in evidence.noted:
        return None
    told = [brighter[(brighter < UNTOLD).all(axis=1)] for brighter in evidence.noted[DRIFT]]
    if not any(len(t) > 1 for t in told):
        return Decision(False, None, bound, "no source view shows a background that stays the same")
    changes = np.array([np.ptp(t, axis=0).max() if len(t) else 0.0 for t in told])
    worst = int(changes.argmax())
    most, name = float(changes[worst]), evidence.rig.names[evidence.sources[worst]]
    return Decision(
        most > bound, most, bound, f"the light of what is behind the subject changes by {most:.2f} stops in {name}"
    )


def _nothing_to_average(evidence: Evidence) -> str | None:
    """Why there is no noise to average away."""
    if SEVERAL_FRAMES not in evidence.facts:
        return "the capture has a single frame"
    return "the pictures are linear light" if LINEAR_LIGHT in evidence.facts else None


def worked_noise(evidence: Evidence, measure: str) -> float:
    """Noise, 1/255, of the pictures that are worked on, median of the source views: of what the survey noted as
    `measure` [S, octave]."""
    sizes = size_worked_at(evidence.rig, evidence.source_rig, evidence.captured_to_calibrated)[list(evidence.sources)]
    return float(np.median([noise_at(n, s) for n, s in zip(evidence.noted[measure], sizes, strict=True)]))


def _noise(evidence: Evidence, bound: float) -> Decision | None:
    if UNREST not in evidence.noted:
        return None
    level = worked_noise(evidence, UNREST)
    told = f"source pictures change by noise of {level:.2f}/255 from frame to frame where nothing moves"
    return Decision(level > bound, level, bound, told)


LIGHT_STEADYING = Effect(
    facts.LIGHT_STEADYING,
    "Bring every picture to its camera's usual light, by the background behind the subject.",
    "largest change of a source camera's light over time",
    CHANGES,
    "stops",
    _drift,
    asks=(DRIFT,),
    lacks=_no_still_background,
)
NOISE_AVERAGING = Effect(
    facts.NOISE_AVERAGING,
    "Average source pictures and their depth with the frames around them where these show the same.",
    "noise of source pictures from frame to frame",
    # Depth and colour pass noise on, up to half as much again: pictures of a person who stands still would change by a
    # step of 255 on the mean.
    0.6,
    "of 255",
    _noise,
    asks=(UNREST,),
    lacks=_nothing_to_average,
)
EXPOSURE_MATCHING = Effect(
    facts.EXPOSURE_MATCHING,
    "Multiply each source view's light by one gain a channel, so that cameras agree on the surfaces they share.",
    "largest proven difference between cameras",
    # Of equal cameras up to 0.1 stops are "proven" (a synthetic person, 128 to 256 px); 0.25 stops are just visible.
    0.25,
    "stops",
    _exposure,
    asks=(SURFACE, SHARED_LIGHT, EXPOSURE),
    lacks=_single_view,
)
OUTLINE_REDRAWING = Effect(
    facts.OUTLINE_REDRAWING,
    "Redraw the outlines of a source view's given masks along the edges that its pictures have.",
    "share of the edges' slope that outlines miss",
    # Right masks of 84 sets of pictures, plain or cluttered, blurred, noisy, striped: 3 miss more than 0.2, 7 more than
    # this; of a man outlined by hand in a cluttered room, of half the size, and of a head, narrow on one side: 0.05,
    # 0.09 and 0.10. As networks make them: 0.22 to 0.31.
    0.18,
    "1",
    _ragged,
    asks=(SLOPES,),
    lacks=_no_outlines,
)
OUTLINE_CORRECTION = Effect(
    facts.OUTLINE_CORRECTION,
    "Move the outlines of a source view's given masks to where its pictures have their edges.",
    "largest distance between outlines and edges",
    # Exact masks of 12 people measure up to 0.13 px off at 512 px and 0.15 at 192, of a person 130 px tall in a
    # chequered shirt 0.73; masks that are a px too wide 1.12 to 1.76. Those of a head that were drawn by hand lie up to
    # 0.81 inside: pictures whose outlines are moved there lose 0.9 dB against photographs that are cut out likewise.
    1.0,
    "px",
    _outlines,
    asks=(OUTLINES,),
    lacks=_no_outlines,
)
GAP_OPENING = Effect(
    facts.GAP_OPENING,
    "Take out of a source view's given masks what lies beside the body and looks like the backdrop.",
    "largest share of a view's masks",
    # Exact masks of 17 people before plain backdrops and in rooms: up to 0.003; with the very colour of their hair,
    # trousers or jackets behind six of them: up to 0.026. Masks whose gaps are filled, in the view that shows most:
    # 0.06 and more.
    0.03,
    "1",
    _gaps,
    asks=(GAPS, JOINT_FIT),
    lacks=_no_gaps,
)
TONE_MAPPING = Effect(
    facts.TONE_MAPPING,
    "Bring light beyond white below it, by one curve for the whole sequence.",
    "largest share of a view's pixels beyond white",
    # A thousandth of a picture, glints and lamps, may be clipped without a loss to the subject.
    0.001,
    "1",
    _beyond_white,
    asks=(LIGHT,),
    lacks=_no_light,
)
