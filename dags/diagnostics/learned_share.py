"""How much of what was reconstructed is learned, and how much is the analytic floor."""

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
    the mean share of the learned value, and the view with the least."""
    said = []
    for plan in plans:
        context, results = plan.context, Results(plan.context)
        if NETWORK in context.unneeded() or not results.has("network/share"):
            continue
        frames = range(len(context.source_frames))
        try:
            shares = {
                context.views.names[v]: results.read("network/share", frames, v)[:, 0] for v in context.views.sources
            }
        except ShardMissing:  # a run of some partitions: nothing is said of a part
            continue
        means = {name: float(np.mean(share[share > 0])) if (share > 0).any() else 0.0 for name, share in shares.items()}
        least = min(means, key=lambda name: means[name])
        weights = settled(context.settings.network, context.facts).weights
        said.append(
            f"{context.sequence.name}: {np.mean(list(means.values())):.0%} of depth and Gaussians are the network's"
            f" ({weights}), the rest the analytic floor's; least in {least},"
            f" {means[least]:.0%}"
        )
    return said
