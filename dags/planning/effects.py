"""Which effects are on for a sequence: settings, measures and the survey's notes become decisions, with reasons.

An effect that needs a measure of the frames stays undecided until the survey ran; work behind it waits for the survey.
Only the decision enters fingerprints, so neither ten more frames nor a slightly different measure make anything stale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from posegaussian.dags.config.effect_settings import Setting, declared
from posegaussian.stages.contract.declaration import Decision, Effect, Evidence


@dataclass(frozen=True)
class EffectVerdict:
    """What is known of one effect of one sequence."""

    effect: Effect
    stages: tuple[str, ...]
    """Stages that depend on it."""
    setting: Setting
    """What the configuration says."""
    decision: Decision | None
    """None: the survey must run first."""
    asks: tuple[str, ...] = ()
    """Outputs of the survey that decide; empty where it is decided without."""

    @property
    def state(self) -> Literal["on", "off", "undecided"]:
        """on, off, or undecided until the survey ran."""
        return "undecided" if self.decision is None else "on" if self.decision.on else "off"

    @property
    def sentence(self) -> str:
        """`temporal_smoothing on (auto): ...`, for the run's log."""
        assert self.decision is not None, f"{self.effect.name} is not decided"
        return (
            f"{self.effect.name} {self.state} ({self.setting if self.setting == 'auto' else 'forced'}):"
            f" {self.decision.reason}"
        )


def judged(evidence_of: Callable[[str], Evidence], settings: Any) -> dict[str, EffectVerdict]:
    """Every effect of the registry, in the order of flow; an effect that is on is a fact for those behind it.

    Args:
        evidence_of: the evidence for a stage's decisions.
        settings: `EffectSettings`.
    """
    found: dict[str, EffectVerdict] = {}
    for name, (effect, stages) in declared().items():
        before = {n for n, v in found.items() if v.state != "off"}
        evidence = evidence_of(stages[0])
        evidence = replace(evidence, facts=evidence.facts | before)
        found[name] = _judged(effect, stages, getattr(settings, name), evidence)
    return found


def _judged(effect: Effect, stages: tuple[str, ...], setting: Setting, evidence: Evidence) -> EffectVerdict:
    missing = effect.lacks(evidence)
    if missing is not None:
        return EffectVerdict(
            effect,
            stages,
            setting,
            Decision(
                False,
                None,
                effect.threshold,
                f"effects.{effect.name} is on, but {missing}" if setting == "on" else missing,
            ),
        )
    measured = effect.decide(evidence, effect.threshold)
    if setting == "auto":
        asks = (
            effect.asks if effect.asks and effect.decide(replace(evidence, noted={}), effect.threshold) is None else ()
        )
        return EffectVerdict(effect, stages, setting, measured, asks)
    reason = f"effects.{effect.name} is {setting}" + (f"; {measured.reason}" if measured is not None else "")
    return EffectVerdict(
        effect,
        stages,
        setting,
        Decision(setting == "on", measured.measured if measured else None, effect.threshold, reason),
    )


def refusals(evidence_of: Callable[[str], Evidence], verdicts: Mapping[str, EffectVerdict]) -> list[str]:
    """Why effects cannot be forced off."""
    forced = [v for v in verdicts.values() if v.setting == "off"]
    return [why for v in forced if (why := v.effect.refusal(evidence_of(v.stages[0]))) is not None]


def noted(receipts: Mapping[int | None, Any], arrays: tuple[str, ...]) -> dict[str, np.ndarray] | None:
    """{array: [S, ...]} from the receipts of the survey by source view, in order; None where one does not hold a
    value."""
    found = {}
    for array in arrays:
        values = [r.facts.get("noted", {}).get(array) for r in receipts.values()]
        if any(v is None for v in values):
            return None
        found[array] = np.array(values)
    return found
