"""What `network.weights: auto` comes to: by the angles between cameras, and where nothing refines what weights spoil by
pictures of left-out source views."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from posegaussian.stages.contract.declaration import Choice, Evidence, Picked
from posegaussian.stages.contract.facts import REFINING, Facts, fact
from posegaussian.stages.contract.judged import LEARNED, MATTES, cannot_judge, drawn_at, mean_scores
from posegaussian.stages.geometry.pairs import neighbour_angles
from posegaussian.stages.network.card import read_card, shipped
from posegaussian.stages.network.model.presets import LONELY_ANGLE, TRAINED_ANGLE, Preset
from posegaussian.stages.network.params import AUTO, NONE, NetworkParams
from posegaussian.storage.model.cameras import Rig

CANDIDATES = (NONE, *shipped())
"""What `auto` chooses from; along `judge/network`."""
PICKED = {name: fact("no_weights" if name == NONE else f"{name}_weights") for name in CANDIDATES}
"""{candidate: the fact that `auto` comes to it}."""


def weights_choice(params: NetworkParams, facts: Facts) -> tuple[str, str]:
    """The weights and one sentence that says why; while `auto` is undecided those that are tried first."""
    if params.weights != AUTO:
        return params.weights, f"network.weights is {params.weights}"
    picked = next((name for name, told in PICKED.items() if told in facts), None)
    if picked is not None:
        return picked, "pictures of left-out source views say so, or the angles between cameras"
    return CANDIDATES[-1], "the weights that ship"


def settled(params: NetworkParams, facts: Facts) -> NetworkParams:
    """The settings with `auto` resolved."""
    return params.model_copy(update={"weights": weights_choice(params, facts)[0]})


def by_pictures(params: NetworkParams, facts: Facts) -> bool:
    """Whether `auto` must be decided."""
    return params.weights == AUTO


def pick(evidence: Evidence) -> Picked | None:
    """The weights that fit these cameras; unrefined, unless left-out views are drawn with a lower SSIM than without.

    Left-out views, which are drawn unrefined, do not tell what weights are worth to refined pictures: fifteen tuning
    people like captures, seen by four to eight cameras (384 px), gain 0.20 dB by them (-0.20 to +0.63), three that
    left-out views refuse 0.06, 0.29 and 0.63, and `balance` loses its shreds by weights that they refuse.
    """
    fitting, angle = fitting_weights(evidence.rig, evidence.sources)
    if not fitting:
        return Picked(PICKED[NONE], angle)
    if REFINING in evidence.facts:
        return Picked(PICKED[fitting[0]], f"{angle}, and refined pictures gain by {fitting[0]}")
    blind = cannot_judge(len(evidence.sources), bool(evidence.facts & set(MATTES.values())))
    if blind is None and LEARNED not in evidence.noted:
        return None
    means = None if blind is not None else mean_scores(evidence.noted[LEARNED])
    if means is None:
        why = blind or "no source view could be drawn from the others"
        return Picked(PICKED[fitting[0]], f"{why}; {angle}, and on people it never saw {fitting[0]} gained")
    told = ", ".join(f"{name} {drawn_at(means, i)}" for i, name in enumerate(CANDIDATES) if name in (NONE, *fitting))
    best = best_of(means, fitting)
    return Picked(
        PICKED[CANDIDATES[best]],
        f"left-out source views, drawn from the others: {told} (SSIM decides)",
    )


def best_of(means: np.ndarray, fitting: Sequence[str]) -> int:
    """Index of the candidate that counts, from `mean_scores` [candidate, measure]: the weights with the highest SSIM,
    where that is not below none's; else none, 0.

    Not PSNR: a left-out view is drawn across twice a run's gap, where details that are sharp but a little off their
    place cost most. What weights gain there in PSNR was measured up to 2.5 dB too low, while SSIM's sign was right.
    """
    good = [i for i, name in enumerate(CANDIDATES) if name in fitting and means[i, 1] >= means[0, 1]]
    return max(good, key=lambda i: means[i, 1], default=0)


def fitting_weights(rig: Rig, sources: Sequence[int]) -> tuple[list[str], str]:
    """The weights with something to say about these source views, at most one, and why: of those trained on pairs as
    wide as half of the views have to their nearest, the ones trained on the least wide, which know such pairs best.

    Left-out views tell weights from none, not weights from each other: on a person seen by eight cameras they have
    .943 with `wide` and .941 with `fast`, which draws the pictures between the cameras 0.6 dB better.
    """
    if len(sources) < 2:
        return [], "there is a single source view, and what weights that ship gain on its relief was not shown"
    apart = neighbour_angles(rig, sources)
    usual, nearest = float(np.median(apart)), float(apart.min())
    widest = {n: _preset(n).widest for n in CANDIDATES[1:]}
    name = min((n for n, w in widest.items() if nearest <= w), key=lambda n: (usual > widest[n], widest[n]), default="")
    if not name:
        limit = max(widest.values(), default=0.0)
        return [], f"the nearest two source views stand {nearest:.0f} degrees apart, beyond the {limit:.0f} trained on"
    said = f"half of the source views stand within {usual:.0f} degrees of another"
    return [name], f"{said}, and {name} was trained on pairs of up to {widest[name]:.0f}"


def widest_angle(params: NetworkParams) -> float:
    """Degrees between the views of the widest pairs that weights by these settings may look at; a file of weights is
    taken for trained up to `TRAINED_ANGLE`."""
    names = CANDIDATES[1:] if params.weights == AUTO else (params.weights,)
    trained = max((_preset(n).widest for n in names if n in CANDIDATES[1:]), default=TRAINED_ANGLE)
    return max(trained, LONELY_ANGLE)


@cache
def _preset(name: str) -> Preset:
    return Preset.from_json(read_card(shipped()[name]).network)


WEIGHTS = Choice("weights", weights_choice, by_pictures, pick, (LEARNED,), tuple(PICKED.values()))
