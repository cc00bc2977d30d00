"""What `depth.method: auto` comes to by pictures of left-out source views."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Choice, Evidence, Picked
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.judged import DEPTH, MATTES, cannot_judge, drawn_at, mean_scores
from posegaussian.stages.depth.methods.registry import BY_PICTURES, METHODS
from posegaussian.stages.depth.params import AUTO, PICKED, DepthParams, method_choice


def by_pictures(params: DepthParams, facts: Facts) -> bool:
    """Whether pictures have a say: where matching is what `auto` comes to."""
    return params.method == AUTO and method_choice(params, facts)[0] in BY_PICTURES


def pick(evidence: Evidence) -> Picked | None:
    """The method that draws left-out views with the highest mean PSNR; where none can be judged, the one that was
    best elsewhere, with the reason.

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
    order = sorted(range(len(BY_PICTURES)), key=lambda i: (-means[i, 0], -(METHODS[BY_PICTURES[i]].quality or 0)))
    told = [f"{BY_PICTURES[i]} {drawn_at(means, i)}" for i in order]
    return Picked(
        PICKED[BY_PICTURES[order[0]]], f"left-out source views, drawn from the others: {told[0]}; {', '.join(told[1:])}"
    )


METHOD = Choice("method", method_choice, by_pictures, pick, (DEPTH,), tuple(PICKED.values()))
