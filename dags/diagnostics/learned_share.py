"""How often the network holds its depth for better than the analytic floor's."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.results import Results
from posegaussian.stages.network.choice import settled
from posegaussian.stages.network.params import NETWORK
from posegaussian.storage.model.errors import ShardMissing


def sentences(plans: Iterable[Plan]) -> list[str]:
    """One sentence a sequence in which the network ran:
    the mean of its confidence, and the view with the least."""
    said = []
    for plan in plans:
        context, results = plan.context, Results(plan.context)
        if NETWORK in context.unneeded() or not results.has("network/share"):
            continue
        frames = range(len(context.source_frames))
        try:
            sure = {
                context.views.names[v]: results.read("network/share", frames, v)[:, 0] for v in context.views.sources
            }
        except ShardMissing:  # a run of some partitions: nothing is said of a part
            continue
        means = {name: float(np.mean(share[share > 0])) if (share > 0).any() else 0.0 for name, share in sure.items()}
        least = min(means, key=lambda name: means[name])
        weights = settled(context.settings.network, context.facts).weights
        said.append(
            f"{context.sequence.name}: the network ({weights}) holds its depth for better than the analytic floor's at"
            f" {np.mean(list(means.values())):.0%} of the surface; least in {least}, {means[least]:.0%}"
        )
    return said
