"""Which cameras show nothing, and which contradict the others: by silhouettes or joints, which say how they stand, and
then by lines, where every pair has a vote, and the larger party is believed.

A wrong camera contradicts most of those it is compared with, and each of these contradicts only the wrong ones, so that
cameras fall into parties; the larger one is believed, and whoever more than half of it contradicts is not. Wrong
cameras that agree with each other, a part of a rig that was registered apart, are one party.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from posegaussian.stages.contract.trust import JOINTS_AGREE, KINDS, Belief, Told, Trust
from posegaussian.stages.imaging.small_turns import APART, SIDE, turned
from posegaussian.stages.survey.measures.agreement import NAME
from posegaussian.stages.survey.measures.contrast import CONTRAST
from posegaussian.stages.survey.measures.standing import STANDING

BOUNDS = {"features": 0.003, "outlines": 0.003, "joints": 0.016}
"""Share of the longer side of the picture by which what two cameras see misses their lines when they contradict each
other. Of seven photographs of a head, calibrated by structure from motion, features miss by 0.0004 to 0.001, outlines
by 0.0001 to 0.0022, and by 0.005 to 0.013 those of three that hang on them wrongly; a pixel of these is taken off.
Joints as a detector finds them scatter by 0.004 and are elsewhere on a body seen from elsewhere."""
SURE = {"features": 0.003, "outlines": 0.003, "joints": JOINTS_AGREE}
"""Share up to which two cameras agree; in between a kind says nothing."""
FEWEST_TOLD = {"features": 8, "outlines": 1, "joints": 1}
"""Points, sides or frames below which a kind says nothing."""
WEIGHTS = {"features": 2, "outlines": 1, "joints": 1}
"""Features are many and precise: masks that are wrong in one view, or a detector, do not outvote them alone; both
together do, as of a camera that is out of step before a background that stands still."""
MAJORITY = 0.5
"""Share of the believed cameras it can be compared with that must contradict a camera, at least."""
ACCUSERS = 2
"""Believed cameras, at least, that must contradict it."""
NOTHING, SOMETHING = 12.0, 48.0
"""Brightness, of 255, within which pictures vary that show nothing, and by which those of the others must. Black ones
with noise of 12 vary by 2, twelve simulated people of 192 and 512 px inside their masks by 49 to 201, `bust`, of
marble, by 35 to 154; one in plain dark clothes, seen from behind, by 5, and with what lies around by 90."""
BY_SILHOUETTES, BY_JOINTS = ("silhouette lies", "what the others leave"), ("joints lie", "those of the others")
"""What of a camera that is turned lies beside what."""
MOVED = (
    "it was moved by {:.2f} degrees between frames {:.0f} and {:.0f}, as what it shows of the subject tells: how it"
    " stands is known in one part of the take at most"
)
IN_PLACE = (
    "; its features agree with {} of these and contradict none: it may well stand right, and its masks or its moment be"
    " what is wrong"
)
OUT_OF_STEP = (
    "what it shows of the subject lies {:.2f} % of the picture's longer side beside what the others leave, what it"
    " shows {frames} {} does not: it seems {} by {frames}"
)
CORRECTED, HALF = "; set frames.time_offset: {{{}: {:g}}}", ", and half a frame cannot be corrected"
UPSIDE_DOWN = (
    "its joints lie {:.2f} % of the picture's longer side beside those of the others; turned by 180 degrees they would"
    " not: its pictures seem upside down against its calibration: write them the other way round (ffmpeg -i IN -vf"
    " hflip,vflip OUT) and import again"
)
LACKS = "its masks lack something that those of the others have, and its own outline contradicts none: it stands right"
WORDS = {"features": "matched features", "outlines": "outlines of masks", "joints": "joints"}


def believed(names: tuple[str, ...], noted: Mapping[str, np.ndarray]) -> tuple[Belief, ...]:
    """What the pairs' agreement [S, S, 3, 2], each pair in either order, the cameras' standing [S, 7] and the contrast
    of their pictures [S] say of each of S cameras."""
    one_way = np.asarray(noted[NAME], dtype=np.float64)
    pairs = np.maximum(one_way, np.swapaxes(one_way, 0, 1))
    votes = _votes(pairs)
    kept = _majority(votes)
    found = [_belief(v, pairs, votes, kept) for v in range(len(names))]
    standing = np.asarray(noted[STANDING], np.float64)
    exchanged = [n for n, row in zip(names, standing, strict=True) if row[4] == Told.EXCHANGED]
    stand = [
        _stands(name, b, row, [n for n in exchanged if n != name])
        for name, b, row in zip(names, found, standing, strict=True)
    ]
    blank = _blank(np.asarray(noted[CONTRAST], np.float64))
    return tuple(blank.get(v, belief) for v, belief in enumerate(stand))


def outlines_agree(pairs: np.ndarray) -> tuple[float | None, int]:
    """Share of the pairs of S cameras, of [S, S, 4, 2], whose outlines agree, and of how many; None of none."""
    off, count = np.moveaxis(np.asarray(pairs)[:, :, KINDS.index("outlines")], -1, 0)
    known = count >= FEWEST_TOLD["outlines"]
    return (float((off[known] <= BOUNDS["outlines"]).mean()) if known.any() else None), int(known.sum())


def _votes(pairs: np.ndarray) -> np.ndarray:
    """[S, S] int: 1 where two cameras agree, -1 where they contradict each other, 0 where nothing is known."""
    score = np.zeros(pairs.shape[:2], int)
    said = {}
    for k, kind in enumerate(KINDS):
        said[kind] = _said(kind, pairs[..., k, :])
        score += WEIGHTS[kind] * said[kind]
    of_the_subject = (said["outlines"] < 0) & (said["joints"] < 0)
    return np.where((score < 0) | of_the_subject, -1, np.sign(score))


def _said(kind: str, told: np.ndarray) -> np.ndarray:
    """[...] int: what a kind alone says of pairs, of how far they miss their lines and how many tell [..., 2]: as
    `_votes`."""
    off, count = told[..., 0], told[..., 1]
    agree = np.where(off > BOUNDS[kind], -1, np.where(off <= SURE[kind], 1, 0))
    return np.where(count < FEWEST_TOLD[kind], 0, agree)


def _blank(contrast: np.ndarray) -> dict[int, Belief]:
    """The verdict on cameras whose pictures show nothing, by number: fewer than half of them, where the others show
    something; contrast [S] is negative where it is not known."""
    known = contrast >= 0
    nothing = known & (contrast < NOTHING)
    others = contrast[known & ~nothing]
    if 2 * nothing.sum() >= len(contrast) or not len(others) or np.median(others) < SOMETHING:
        return {}
    reason = (
        "its pictures show nothing: the brightness of the subject and what is around it varies by {:.1f} of 255, of the"
        " other cameras by {:.0f}"
    )
    return {int(v): Belief(False, None, reason.format(contrast[v], np.median(others))) for v in np.flatnonzero(nothing)}


def _stands(name: str, belief: Belief, standing: np.ndarray, exchanged: list[str]) -> Belief:
    """The verdict on one camera, with what is seen of how it stands [7]: turn, px apart over the longer side,
    `Told` and two source frames, or frames by which it is late, where `exchanged` are cameras whose files may be
    exchanged."""
    *turn, apart, told, before, after = map(float, standing)
    measured, most = 100 * BOUNDS["features"] * apart / (APART / SIDE), 100 * APART / SIDE
    if told == Told.MOVED:
        return Belief(False, measured, MOVED.format(np.degrees(np.linalg.norm(turn)), before, after), moved=True)
    if told == Told.LATE:
        return Belief(False, measured, _out_of_step(name, 100 * apart, before), late=before)
    seen, others = BY_JOINTS if told == Told.BY_JOINTS else BY_SILHOUETTES
    beside = f"its {seen} {100 * apart:.2f} % of the picture's longer side beside {others}"
    if told in (Told.WRONG, Told.EXCHANGED, Told.MIRRORED):
        reason = f"{beside} (at most {most:.2g}), however it is turned"
        if exchanged and told == Told.EXCHANGED:
            reason += f"; in the place of {exchanged[0]} it would not: their files seem exchanged"
        if told == Told.MIRRORED:
            reason += "; mirrored left-right it would not: its pictures seem mirrored"
        return Belief(False, measured, reason)
    if told == Told.UPSIDE_DOWN:
        return Belief(False, measured, UPSIDE_DOWN.format(100 * apart))
    if told == Told.LACKING and belief.in_place:
        return replace(belief, believed=True, reason=f"{LACKS}; {belief.reason}")
    if not belief.believed or not any(turn):
        return belief
    return replace(
        belief,
        measured=belief.measured or 0.0,
        turn=(turn[0], turn[1], turn[2]),
        reason=f"as it is written down {beside}, turned it does not; {belief.reason}",
    )


def _out_of_step(name: str, apart: float, late: float) -> str:
    """What is said of a camera that is late by some frames, or early where these are negative, `apart` in %."""
    frames = "half a frame" if abs(late) == 0.5 else f"{abs(late):g} frame{'s' * (abs(late) > 1)}"
    told = OUT_OF_STEP.format(apart, *(("later", "late") if late > 0 else ("earlier", "early")), frames=frames)
    return told + CORRECTED.format(name, late) * (abs(late) >= 1) + HALF * (late % 1 != 0)


def _majority(votes: np.ndarray) -> set[int]:
    """The cameras that are believed: all of them where no majority agrees against the others.

    The leading eigenvector of the votes splits the cameras into the two parties that contradict each other most; then
    everybody is heard by the larger one, until nothing changes.
    """
    every = set(range(len(votes)))
    lead = np.linalg.eigh(votes.astype(np.float64))[1][:, -1]
    sides = [set(np.flatnonzero(side * lead > 1e-6).tolist()) for side in (1, -1)]
    party, wrong = max(sides, key=len), set[int]()
    for _ in every:
        wrong = {v for v in every if _accused(votes[v, sorted(party - {v})])}
        if party == every - wrong:
            break
        party = every - wrong
    return party if 2 * len(wrong) < len(every) else every


def _accused(votes: np.ndarray) -> bool:
    against, known = int((votes < 0).sum()), int((votes != 0).sum())
    return against >= ACCUSERS and against > MAJORITY * known


def _belief(view: int, pairs: np.ndarray, votes: np.ndarray, kept: set[int]) -> Belief:
    """The verdict on one camera against the believed ones."""
    others = sorted(kept - {view})
    against = [v for v in others if votes[view, v] < 0]
    known = [v for v in others if votes[view, v] != 0]
    if not known:
        return Belief(True, None, "shares nothing with any other camera that could contradict it")
    found = {}
    for k, kind in enumerate(KINDS):
        own = [pairs[view, v, k, 0] for v in known if pairs[view, v, k, 1] >= FEWEST_TOLD[kind]]
        if own:
            found[kind] = float(np.median(own))
    numbers = ", ".join(f"{WORDS[k]} {100 * off:.2f} % (at most {100 * BOUNDS[k]:g})" for k, off in found.items())
    told = (
        f"it contradicts {len(against)} of the {len(known)} believed cameras it can be compared with"
        if view not in kept
        else f"{len(known) - len(against)} of the {len(known)} cameras it can be compared with agree"
    )
    # In units of the features' bound, so that one number is shown whatever told.
    measured = 100 * BOUNDS["features"] * max(off / BOUNDS[k] for k, off in found.items())
    told += f"; medians off their lines, of the picture's longer side: {numbers}"
    votes_of_features = _said("features", pairs[view, known, KINDS.index("features")])
    agree = int((votes_of_features > 0).sum())
    in_place = view not in kept and agree >= ACCUSERS and not (votes_of_features < 0).any()
    return Belief(view in kept, measured, told + IN_PLACE.format(agree) * in_place, in_place=in_place)


TRUST = Trust(
    asks=(NAME, STANDING, CONTRAST),
    bound=100 * BOUNDS["features"],
    unit="%",
    fewest=3,
    decide=believed,
    stand=turned,
)
