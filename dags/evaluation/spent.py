"""What a method costs on a sequence: seconds by the receipts of its tasks, which are the ledger's, and Gaussians."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from posegaussian.dags.compiling.warm_up import WARM_UP, steady_seconds
from posegaussian.dags.evaluation.measured import MEAN, Number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.results import Results
from posegaussian.stages.network.asset import card_of
from posegaussian.stages.network.choice import settled
from posegaussian.stages.network.params import NETWORK
from posegaussian.stages.registry import stage as stage_named
from posegaussian.stages.rendering.facts import FITTED
from posegaussian.stages.rendering.params import IBR
from posegaussian.stages.rendering.sources import COUNTS, REFINEMENT, unrefined_arrays
from posegaussian.storage.archive.receipts import Receipt
from posegaussian.storage.model.errors import ShardMissing

MEASURES = "metrics"
"""The stage that measures and makes nothing: its seconds are no cost of the pictures."""
DRAWS = "rendering"
"""The stage that draws."""
OPTIMISING = "optimising"
"""Module of the stage that draws, where it fits Gaussians to a frame's own pictures."""
SECONDS = "wall seconds of finished tasks by their receipts, one task at a time on one worker, metrics left out"
WARM = "what a process spends once, compiling kernels and importing libraries, left out"
UNTIMED = "but in tasks of a version that did not time that"


def costs(plan: Plan) -> list[Number]:
    """Of a plan that is all fresh: time a frame and by kind, Gaussians a frame."""
    return [*_times(plan), _gaussians(plan)]


def receipts(plan: Plan) -> list[Receipt]:
    """Of all that the method needs and that makes pictures."""
    return [plan.book.receipts[t] for t in plan.verdicts if t.stage != MEASURES]


def hosts(plan: Plan) -> list[str]:
    """`host, device` of the machines that the seconds were taken on."""
    return sorted({f"{r.facts.get('host')}, {r.facts.get('device')}" for r in receipts(plan)})


def told(of: Sequence[Receipt]) -> str:
    """What the seconds of some tasks are."""
    return "; ".join([SECONDS, WARM, *([UNTIMED] if any(WARM_UP not in r.facts for r in of) else [])])


def _times(plan: Plan) -> Iterator[Number]:
    frames, drawn = plan.context.grid.frames, 0
    for path in plan.context.paths.values():
        drawn += int(np.count_nonzero(path.served))
    once = optimised = drawing = every = 0.0
    for r in receipts(plan):
        own = steady_seconds(r.facts)
        if stage_named(r.stage).sequence_wide:
            once += own
            continue
        every += own
        fitting = float((r.facts.get("modules") or {}).get(OPTIMISING, 0.0))
        drawing += own - fitting if r.stage == DRAWS else 0.0
        optimised += own if r.stage == REFINEMENT else fitting
    what = told(receipts(plan))
    all_stages = f"{what}; all stages but what is made once a sequence"
    yield Number("ms_a_frame", "", MEAN, 1000 * every / frames, "ms", f"{all_stages}, over frames", frames)
    yield Number(
        "frames_a_second", "", MEAN, frames / every if every else None, "1/s", f"frames over {all_stages}", frames
    )
    yield Number(
        "drawing", "", MEAN, 1000 * drawing / max(drawn, 1), "ms", f"{what}; drawing alone, over pictures", drawn
    )
    yield Number("once", "", MEAN, once, "s", f"{what}; what is made once a sequence, whatever its frames")
    yield Number(
        "optimised", "", MEAN, optimised / frames, "s", f"{what}; optimising a frame on its own pictures", frames
    )
    yield _weights(plan.context)


def _weights(context: Context) -> Number:
    """How long the weights that the network has were trained, once for all sequences."""
    if NETWORK not in context.facts:
        return Number("trained", "", MEAN, 0.0, "s", "no weights: nothing was trained")
    answer = settled(context.settings.network, context.facts)
    card = card_of(answer)
    trained = f"training of the weights {card.name}, once for all sequences, on {card.machine}"
    return Number("trained", "", MEAN, 60 * card.minutes, "s", trained)


def _gaussians(plan: Plan) -> Number:
    """The mean over frames: of all source views that are drawn, or that were fitted."""
    context, results = plan.context, Results(plan.context, plan.book)
    if context.settings.rendering.method == IBR:
        return Number("gaussians", "", MEAN, None, "1", "not available: pictures are blended, there are no Gaussians")
    drawn = "Gaussians of all source views a frame, of which pictures draw those of the nearest views"
    drawn = "Gaussians fitted to a frame, all of which pictures draw" if FITTED in context.facts else drawn
    try:
        counts = [_count(context, results, context.grid.bounds(p)) for p in context.grid.partitions]
    except ShardMissing as e:
        return Number("gaussians", "", MEAN, None, "1", f"not known: {e}")
    every = np.concatenate(counts)
    return Number("gaussians", "", MEAN, float(every.mean()), "1", drawn, len(every))


def _count(context: Context, results: Results, frames: range) -> np.ndarray:
    """[F] Gaussians of each frame: those fitted to it; else pixels with depth and opacity, before refinement, after it,
    or of both where both are drawn."""
    if FITTED in context.facts:
        (path,) = context.paths
        return results.read(f"rendering/{path}/gaussians", frames).astype(np.int64)
    share = results.read("refinement/outcome", frames)[:, -1] if REFINEMENT in context.facts else np.zeros(len(frames))
    found = np.zeros(len(frames), np.int64)
    arrays = unrefined_arrays(context.facts)
    for view in context.views.sources:
        if (share > 0).any():
            found += np.where(share > 0, results.read(COUNTS, frames, view), 0)
        if (share < 1).any():
            depth, opacity = (results.read(arrays[i], frames, view) for i in (1, 4))
            found += np.where(share < 1, ((depth > 0) & (opacity[:, 0] > 0)).sum(axis=(1, 2)), 0)
    return found
