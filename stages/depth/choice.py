"""What `depth.method: auto` comes to by pictures of left-out source views."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.declaration import Choice, Evidence, Picked
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.judged import DEPTH, MATTES, cannot_judge, drawn_at, mean_scores
from posegaussian.stages.depth.methods.registry import BY_PICTURES, METHODS
from posegaussian.stages.depth.params import AUTO, PICKED, DepthParams, method_choice

TIE = 0.1
"""dB of mean PSNR by which methods may differ and still draw alike. Of fifteen tuning scenes (like captures 1-8;
plain 1, 2, 5, 6 with six cameras, 3, 4, 7 with eight; 512 px) sgbm leads the sweep by 0.03 to 0.1 dB on three: held-out
pictures are 0.21 and 0.41 dB worse with it on two and 0.41 better on one, and the network, which then refines both,
adds 0.1 to 0.4 more to what the sweep made. Nowhere does it lead by more."""


def by_pictures(params: DepthParams, facts: Facts) -> bool:
    """Whether pictures have a say: where matching is what `auto` comes to."""
    return params.method == AUTO and method_choice(params, facts)[0] in BY_PICTURES


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
    means = None if blind is not None else mean_scores(evidence.noted[DEPTH])
    if means is None:
        return Picked(PICKED[usual], f"{blind or 'no source view could be drawn from the others'}; {why}")
    best, order = best_of(means), sorted(range(len(BY_PICTURES)), key=lambda i: -means[i, 0])
    told = ", ".join(f"{BY_PICTURES[i]} {drawn_at(means, i)}" for i in order)
    alike = "" if best == order[0] else f" ({BY_PICTURES[best]} costs least of those within {TIE:g} dB)"
    return Picked(PICKED[BY_PICTURES[best]], f"left-out source views, drawn from the others: {told}{alike}")


def best_of(means: np.ndarray) -> int:
    """Index along `BY_PICTURES` of the method that counts, from `mean_scores` [method, measure]: of those whose PSNR is
    less than `TIE` below the highest the one that costs least.

    The cheaper ones are the steadier ones, too: pictures of a person at rest change less by noise
    (benchmarks.quality.steadiness).
    """
    alike = np.flatnonzero(means[:, 0] > means[:, 0].max() - TIE)
    return int(min(alike, key=lambda i: METHODS[BY_PICTURES[i]].seconds))


METHOD = Choice("method", method_choice, by_pictures, pick, (DEPTH,), tuple(PICKED.values()))
