"""What `network.weights: auto` comes to: by pictures of left-out source views, else by the angles between cameras."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from posegaussian.stages.contract.declaration import Choice, Evidence, Picked
from posegaussian.stages.contract.facts import SINGLE_SOURCE, Facts, fact
from posegaussian.stages.contract.judged import LEARNED, MATTES, cannot_judge, drawn_at, mean_scores
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.network.card import read_card, shipped
from posegaussian.stages.network.model.presets import Preset
from posegaussian.stages.network.params import AUTO, NONE, NetworkParams

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
    """Of the weights whose trained angles some pair of views keeps to those with which left-out views are drawn with
    the highest SSIM, unless that is below none's."""
    fitting, angle = _fitting(evidence)
    if not fitting:
        return Picked(PICKED[NONE], angle)
    blind = cannot_judge(len(evidence.sources), bool(evidence.facts & set(MATTES.values())))
    if blind is None and LEARNED not in evidence.noted:
        return None
    means = None if blind is not None else mean_scores(evidence.noted[LEARNED])
    if means is None:
        why = blind or "no source view could be drawn from the others"
        return Picked(PICKED[fitting[-1]], f"{why}; {angle}, and on people it never saw {fitting[-1]} gained")
    told = ", ".join(f"{name} {drawn_at(means, i)}" for i, name in enumerate(CANDIDATES) if name in (NONE, *fitting))
    best = best_of(means, fitting)
    return Picked(
        PICKED[CANDIDATES[best]],
        f"left-out source views, drawn from the others: {told} (SSIM decides)",
    )


def best_of(means: np.ndarray, fitting: Sequence[str] = CANDIDATES[1:]) -> int:
    """Index of the candidate that counts, from `mean_scores` [candidate, measure]: the weights with the highest SSIM,
    where that is not below none's; else none, 0.

    Not PSNR: a left-out view is drawn across twice a run's gap, where details that are sharp but a little off their
    place cost most. What weights gain there in PSNR was measured up to 2.5 dB too low, while SSIM's sign was right.
    """
    good = [i for i, name in enumerate(CANDIDATES) if name in fitting and means[i, 1] >= means[0, 1]]
    return max(good, key=lambda i: means[i, 1], default=0)


def _fitting(evidence: Evidence) -> tuple[list[str], str]:
    """Weights with something to say about these cameras, and why."""
    if SINGLE_SOURCE in evidence.facts:
        names = [n for n in CANDIDATES[1:] if _preset(n).alone]
        return names, "there is a single source view" + ("" if names else ": the weights that ship compare pairs")
    nearest = nearest_angle(evidence)
    names = [n for n in CANDIDATES[1:] if nearest <= _preset(n).widest]
    said = f"the nearest two source views stand {nearest:.0f} degrees apart"
    widest = max((_preset(n).widest for n in names or CANDIDATES[1:]), default=0.0)
    return names, f"{said}, {'within' if names else 'beyond'} the {widest:.0f} that were trained on"


@cache
def _preset(name: str) -> Preset:
    return Preset.from_json(read_card(shipped()[name]).network)


def nearest_angle(evidence: Evidence) -> float:
    """Degrees between the two source views that stand nearest, at the point the cameras look at."""
    rig = evidence.rig.subset(evidence.sources)
    rays = rig.centres - look_at_point(rig)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    cosine = np.clip(rays @ rays.T, -1.0, 1.0)[np.triu_indices(len(rig), 1)]
    return float(np.rad2deg(np.arccos(cosine.max())))


WEIGHTS = Choice("weights", weights_choice, by_pictures, pick, (LEARNED,), tuple(PICKED.values()))
