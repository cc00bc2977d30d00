"""What `depth.method: auto` comes to by pictures of left-out source views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posegaussian.stages.contract.declaration import Choice, Evidence, Picked
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.judged import DEPTH, MATTES, NONE, cannot_judge, drawn_at, mean_of_asked
from posegaussian.stages.depth.methods.registry import BY_PICTURES, METHODS
from posegaussian.stages.depth.methods.sgbm import METHOD as SGBM
from posegaussian.stages.depth.params import AUTO, PICKED, DepthParams, method_choice
from posegaussian.stages.geometry.pairs import NARROW, NEAR, neighbour_angles
from posegaussian.storage.model.cameras import Rig

TIE = 0.1
"""dB of mean PSNR by which methods may differ and still draw alike. All three asked everywhere, of fifteen tuning
scenes (like captures 1-8; plain 1, 2, 5, 6 with six cameras, 3, 4, 7 with eight; 512 px) sgbm leads the sweep by 0.03
to 0.1 dB on three: held-out pictures are 0.21 and 0.41 dB worse with it on two and 0.41 better on one, and the network,
which then refines both, adds 0.1 to 0.4 more to what the sweep made. Nowhere does it lead by more."""
AHEAD = 1.0
"""dB by which a surface that no picture has a say in must lead those that match. A left-out view is drawn across a gap
twice as wide as any that a run draws: there pairs are hardly comparable, and matching looks no better than the hull, or
worse. In finished pictures matching is ahead of the hull on all fourteen people that were compared (like captures 1-8;
plain 1, 2, 3 with four cameras, 4 with five, 6 with six, 5 with eight; 384 px; by 0.06 to 6 dB), where the judge saw
both within 0.03 dB on four; and on six of the eight left-out cameras of `balance` and `desk`, where it saw the hull
ahead by up to 0.5 dB."""


CLOSE = 40.0
"""Degrees within which a single neighbour of each view is enough to compare pictures well, as along an arc, whose ends
have no second one. With a view left out it is twice as far to the next: sgbm led by 0.4 and 0.2 dB on two of six arcs
of four cameras, where its finished pictures are 2.4 and 0.1 dB worse; on the others they are 0.8 and
0.3 dB worse, as good, and 0.2 better, where it did not lead."""


def by_pictures(params: DepthParams, facts: Facts) -> bool:
    """Whether pictures have a say: where matching is what `auto` comes to."""
    return params.method == AUTO and method_choice(params, facts)[0] in BY_PICTURES


def tried(rig: Rig, sources: Sequence[int]) -> tuple[str, ...]:
    """The methods of `BY_PICTURES` that left-out source views are drawn by.

    Where every source view has two neighbours within `NEAR`, or one within `CLOSE`, sgbm is not asked, which would take
    two fifths of the judge's time. In finished pictures of twelve people with eight or sixteen cameras 22 to 45 degrees
    apart (384 px; docs/measurements/quality.md) it is 0.03 dB worse than the sweep on the mean, from -0.18 to +0.21,
    and left-out views do not tell where it is better. Of fewer cameras they tell on eight of nine people, where it is
    up to 0.37 dB worse and 0.49 better; on `balance` with a camera left out it is 0.5 dB worse. Nor is it asked where a
    view has no neighbour within `NARROW`: of seven people before four cameras all around it is 0.3 dB worse on the
    mean, from -0.4 to +1.5 (docs/measurements/rigs.md), and left-out views took it where it is 1.4 dB worse.
    """
    next_one, second = (
        float(neighbour_angles(rig, sources, nth).max()) if len(sources) > nth else np.nan for nth in (1, 2)
    )
    near = second <= NEAR or (len(sources) > 2 and next_one <= CLOSE)
    return tuple(name for name in BY_PICTURES if not ((near or next_one > NARROW) and name == SGBM.name))


def pick(evidence: Evidence) -> Picked | None:
    """The method that draws left-out views best (`best_of`); where none can be judged, the one that was best
    elsewhere, with the reason.

    Simulated people, one frame at 384 px (benchmarks.quality.choices --size 384, seeds 1 and 3 with 8 cameras, 2 and 4
    with 6): judged at 384 px it takes the best method on all four, at 224 px it loses 0.21 and 0.20 dB on two; the hull
    would lose 3.4 to 4.6.
    """
    usual, why = method_choice(evidence.params, evidence.facts)
    blind = cannot_judge(len(evidence.sources), bool(evidence.facts & set(MATTES.values())))
    if blind is None and DEPTH not in evidence.noted:
        return None
    means = None if blind is not None else mean_of_asked(evidence.noted[DEPTH])
    if means is None:
        return Picked(PICKED[usual], f"{blind or 'no source view could be drawn from the others'}; {why}")
    asked = (i for i in range(len(BY_PICTURES)) if means[i, 0] != NONE)
    best, order = best_of(means), sorted(asked, key=lambda i: -means[i, 0])
    told = ", ".join(f"{BY_PICTURES[i]} {drawn_at(means, i)}" for i in order)
    return Picked(
        PICKED[BY_PICTURES[best]], f"left-out source views, drawn from the others: {told}{_although(best, order)}"
    )


def _although(best: int, order: list[int]) -> str:
    """Why the method that counts is not the first of `order`, the highest PSNR first."""
    blind = [BY_PICTURES[i] for i in order[: order.index(best)] if not METHODS[BY_PICTURES[i]].matches]
    told = [f"{name}, which compares no pictures, leads by less than {AHEAD:g} dB" for name in blind]
    matching = [i for i in order if METHODS[BY_PICTURES[i]].matches]
    if METHODS[BY_PICTURES[best]].matches and best != matching[0]:
        told.append(f"{BY_PICTURES[best]} costs least of those within {TIE:g} dB")
    return f" ({'; '.join(told)})" if told else ""


def best_of(means: np.ndarray) -> int:
    """Index along `BY_PICTURES` of the method that counts, from `mean_of_asked` [method, measure]: of those whose PSNR
    is less than `TIE` below the highest the one that costs least; one that compares no pictures, which costs least of
    all, where it leads those that do by more than `AHEAD`.

    The cheaper ones are the steadier ones, too: pictures of a person at rest change less by noise
    (benchmarks.quality.steadiness).
    """
    counted = means[:, 0] - [0.0 if METHODS[m].matches else AHEAD + TIE for m in BY_PICTURES]
    alike = np.flatnonzero(counted > counted.max() - TIE)
    return int(min(alike, key=lambda i: METHODS[BY_PICTURES[i]].seconds))


METHOD = Choice("method", method_choice, by_pictures, pick, (DEPTH,), tuple(PICKED.values()))
