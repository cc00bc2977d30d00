"""Which effects are on for a sequence, and what its choices come to: settings, measures and notes of sequence-wide
stages become decisions, with reasons.

What needs a measure of the frames stays undecided until the stages that take it ran; work behind it waits for them.
Only the decision enters fingerprints, so neither ten more frames nor a slightly different measure make anything stale.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from posegaussian.dags.config.effect_settings import Setting, declared
from posegaussian.stages.contract.declaration import Choice, Decision, Effect, Evidence, Picked
from posegaussian.stages.registry import STAGES

Answer = TypeVar("Answer")
MEASURED = tuple(frozenset(w.name for w in s.writes) for s in STAGES if s.sequence_wide)
"""Outputs of the sequence-wide stages, stage by stage in the order of flow."""


@dataclass(frozen=True)
class EffectVerdict:
    """What is known of one effect of one sequence."""

    effect: Effect
    stages: tuple[str, ...]
    """Stages that depend on it."""
    setting: Setting
    """What the configuration says."""
    decision: Decision | None
    """None: something must be measured first."""
    asks: tuple[str, ...] = ()
    """Outputs of sequence-wide stages that decide, or may; empty where it is decided without."""

    @property
    def state(self) -> Literal["on", "off", "undecided"]:
        """on, off, or undecided until it was measured."""
        return "undecided" if self.decision is None else "on" if self.decision.on else "off"

    @property
    def sentence(self) -> str:
        """`temporal_smoothing on (auto): ...`, for the run's log."""
        assert self.decision is not None, f"{self.effect.name} is not decided"
        return (
            f"{self.effect.name} {self.state} ({self.setting if self.setting == 'auto' else 'forced'}):"
            f" {self.decision.reason}"
        )


@dataclass(frozen=True)
class ChoiceVerdict:
    """What is known of a choice that measures have a say in."""

    name: str
    """`stage.setting`."""
    choice: Choice
    stages: tuple[str, ...]
    """The stage that declares it."""
    picked: Picked | None
    """None: something must be measured first."""
    asks: tuple[str, ...]
    """As of an effect."""

    @property
    def state(self) -> str:
        """The fact that it came to, or undecided."""
        return "undecided" if self.picked is None else self.picked.fact

    @property
    def sentence(self) -> str:
        """For the run's log."""
        assert self.picked is not None, f"{self.name} is not decided"
        return f"{self.name}: {self.picked.reason}"


class Idle(NamedTuple):
    """An effect that nobody has a use for, or perhaps nobody."""

    reason: str
    """Why."""
    asks: tuple[str, ...]
    """Outputs of sequence-wide stages that tell whether it has one; empty where it has none."""


class Verdicts(NamedTuple):
    """What is known of all effects and of the choices that measures have a say in."""

    effects: dict[str, EffectVerdict]
    """By name, in the order of flow."""
    choices: dict[str, ChoiceVerdict]
    """By name, in the order of flow."""

    @property
    def every(self) -> list[EffectVerdict | ChoiceVerdict]:
        """Effects, then choices."""
        return [*self.effects.values(), *self.choices.values()]

    @property
    def open(self) -> list[EffectVerdict | ChoiceVerdict]:
        """The undecided ones."""
        return [v for v in self.every if v.state == "undecided"]

    @property
    def asked(self) -> set[str]:
        """Outputs of sequence-wide stages that decide, or may."""
        return {a for v in self.every for a in v.asks}


def judged(
    evidence_of: Callable[[str], Evidence], settings: Any, idle: Mapping[str, Idle] = MappingProxyType({})
) -> Verdicts:
    """Every effect and choice of the registry, in the order of flow; an effect that is on, and what a choice came to,
    is a fact for those behind it.

    Args:
        evidence_of: the evidence for a stage's decisions.
        settings: `EffectSettings`.
        idle: effects that nobody has a use for, by name.
    """
    found, every = Verdicts({}, {}), declared()
    for stage in STAGES:
        for choice in stage.choices:
            evidence = _behind(found, evidence_of(stage.name))
            if choice.pick is not None and choice.picks(evidence.params, evidence.facts):
                asks, picked = _measured(choice.asks, choice.pick, evidence)
                name = f"{stage.name}.{choice.setting}"
                found.choices[name] = ChoiceVerdict(name, choice, (stage.name,), picked, asks)
        for effect in stage.effects:
            if effect.name not in found.effects:
                stages = every[effect.name][1]
                evidence = _behind(found, evidence_of(stages[0]))
                found.effects[effect.name] = _judged(
                    effect, stages, getattr(settings, effect.name), evidence, idle.get(effect.name)
                )
    return found


def _behind(found: Verdicts, evidence: Evidence) -> Evidence:
    """The evidence with what was decided so far among the facts."""
    on = {n for n, v in found.effects.items() if v.state != "off"}
    return replace(evidence, facts=evidence.facts | on | {v.picked.fact for v in found.choices.values() if v.picked})


def _measured(
    asks: tuple[str, ...], decide: Callable[[Evidence], Answer | None], evidence: Evidence
) -> tuple[tuple[str, ...], Answer | None]:
    """The outputs that decide, or may while nothing is decided, and the decision: a stage's outputs count where those
    of the stages before it leave it open."""
    asked: tuple[str, ...] = ()
    for outputs in (frozenset(), *MEASURED):
        more = tuple(a for a in asks if a in outputs)
        if outputs and not more:
            continue
        asked += more
        if not set(asked) <= evidence.noted.keys():
            return asks, None
        answer = decide(replace(evidence, noted={a: evidence.noted[a] for a in asked}))
        if answer is not None:
            return asked, answer
    return asks, None


def _judged(
    effect: Effect, stages: tuple[str, ...], setting: Setting, evidence: Evidence, idle: Idle | None
) -> EffectVerdict:
    missing = effect.lacks(evidence)
    if missing is None and idle is not None:
        if idle.asks:
            found = _judged(effect, stages, setting, evidence, None)
            return found if found.state == "off" else replace(found, decision=None, asks=(*found.asks, *idle.asks))
        missing = idle.reason
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
    if setting == "auto":
        asks, decision = _measured(effect.asks, lambda e: effect.decide(e, effect.threshold), evidence)
        return EffectVerdict(effect, stages, setting, decision, asks)
    measured = effect.decide(evidence, effect.threshold)
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


def noted(receipts: Iterable[Any], arrays: tuple[str, ...], per_view: bool) -> dict[str, np.ndarray] | None:
    """{array: values} from the receipts of one sequence-wide stage: [S, ...] by source view, in order, or those of its
    only task; None where one does not hold a value."""
    found = {}
    for array in arrays:
        values = [r.facts.get("noted", {}).get(array) for r in receipts]
        if any(v is None for v in values):
            return None
        found[array] = np.array(values if per_view else values[0])
    return found
