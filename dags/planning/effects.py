"""Which effects are on for a sequence, and what its choices come to: settings, measures and notes of sequence-wide
stages become decisions, with reasons.

What needs a measure of the frames stays undecided until the stages that take it ran; work behind it waits for them.
Only the decision enters fingerprints, so neither ten more frames nor a slightly different measure make anything stale;
and the cameras as they stand, where an effect turns them.

No stage runs without a reader. An output that is kept `until_done` serves its readers; every other one is a result. A
stage that makes no result and whose outputs no stage reads is not needed, and an effect that only such a stage has, or
that only draws such an output, is off. Whoever names the stage (`--only`, `--force`) or the array
(`keep: {ARRAY: always}`, an export) still gets it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from posegaussian.dags.config.effect_settings import Setting, declared
from posegaussian.stages.contract.declaration import Choice, Decision, Effect, Evidence, Picked, Stage
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Views
from posegaussian.stages.contract.trust import CameraVerdict, TrustSetting, judged_cameras
from posegaussian.stages.registry import STAGES, TRUST
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.spec import ArraySpec, TableSpec

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
    uses = effect.uses if setting == "on" else ()
    if not set(uses) <= evidence.noted.keys():
        return EffectVerdict(effect, stages, setting, None, uses)
    measured = effect.decide(evidence, effect.threshold)
    reason = f"effects.{effect.name} is {setting}" + (f"; {measured.reason}" if measured is not None else "")
    return EffectVerdict(
        effect,
        stages,
        setting,
        Decision(setting == "on", measured.measured if measured else None, effect.threshold, reason),
        uses,
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


def as_they_stand(rig: Rig, effects: Mapping[str, EffectVerdict], notes: Mapping[str, np.ndarray]) -> Rig:
    """Calibrated cameras as effects that are on say they stand; as they are calibrated until that is decided."""
    for v in effects.values():
        if v.effect.stand is not None and v.state == "on":
            rig = v.effect.stand(rig, {array: notes[array] for array in v.effect.uses})
    return rig


OF_PAIRS = frozenset(w.name for s in STAGES for w in s.writes if isinstance(w, ArraySpec) and "other_view" in w.dims)
"""Arrays of pairs of cameras."""


def verdicts_on_cameras(
    asked: Views, setting: TrustSetting, notes: Mapping[str, np.ndarray]
) -> dict[str, CameraVerdict]:
    """What is known of every camera that is asked to be a source, by name."""
    sources = list(asked.sources)
    told = {a: notes[a][:, sources] if a in OF_PAIRS else notes[a] for a in TRUST.asks if a in notes}
    return judged_cameras(TRUST, tuple(asked.names[v] for v in sources), setting, told)


def as_believed(rig: Rig, cameras: Mapping[str, CameraVerdict]) -> Rig:
    """Cameras as they are written down, those turned that are believed to stand so."""
    turns = np.array([cameras[name].turn if name in cameras else np.zeros(3) for name in rig.names])
    return TRUST.stand(rig, turns) if turns.any() else rig


def not_off(settings: Any) -> Facts:
    """Effects that there are and that are not set off: what cameras see is known before effects are decided."""
    return Facts(frozenset(e.name for s in STAGES for e in s.effects if getattr(settings, e.name) != "off"))


def add_waits(
    found: dict[str, dict[str, None]],
    undecided: Iterable[EffectVerdict | ChoiceVerdict],
    wide_ones: Sequence[Stage],
    noted: Mapping[str, np.ndarray],
) -> None:
    """Add to {stage: outputs of sequence-wide stages} those that what is undecided waits for, among the stages' own and
    `noted` ones aside."""
    served = {w.name for s in wide_ones for w in s.writes}
    for v in undecided:
        missing = [a for a in v.asks if a not in noted and a in served]
        for s in v.stages:
            found.setdefault(s, {}).update(dict.fromkeys(missing))
        before: list[str] = []
        for wide in wide_ones:
            own = [a for a in missing if a in {w.name for w in wide.writes}]
            if own and before:
                found.setdefault(wide.name, {}).update(dict.fromkeys(before))
            before += own


def of_believed(
    notes: Mapping[str, np.ndarray], asked: Sequence[int], believed: Sequence[int]
) -> dict[str, np.ndarray]:
    """{array: values} where those that were measured of every camera that is asked for have the rows [S, ...] of those
    that are believed."""
    rows = [i for i, v in enumerate(asked) if v in believed]
    of_all = {w.name for s in STAGES if s.trust is not None for w in s.writes}
    return {array: values[rows] if array in of_all else values for array, values in notes.items()}


@dataclass(frozen=True)
class Demand:
    """Who is needed for what, under some facts."""

    gone: dict[str, str]
    """{stage: why it is not needed}; sequence-wide stages only by their own word."""
    read: frozenset[str]
    """Outputs, as declared, that are asked for by name or that a needed stage reads."""

    @classmethod
    def of(cls, params: Callable[[Stage], Any], facts: Facts, asked: frozenset[str]) -> Demand:
        """From the last stage to the first. `asked`: stages and outputs that are named."""
        gone: dict[str, str] = {}
        read = set(asked)
        for stage in reversed(STAGES):
            why = stage.unneeded(params(stage), facts)
            if why is None and not stage.sequence_wide and stage.name not in asked:
                made = stage.writes_for(facts)
                if not any(w.name in read or isinstance(w, TableSpec) or w.keep != "until_done" for w in made):
                    why = f"no stage reads what it makes ({', '.join(w.name for w in made)}) under these settings"
            if why is not None:
                gone[stage.name] = why
            else:
                read |= {r.array for r in stage.reads_for(params(stage), facts) if not r.is_source}
        return cls(gone, frozenset(read))

    def idle(self, effect: str) -> str | None:
        """Why an effect that could be on would change nothing, or None."""
        stages = [s for s in STAGES if any(e.name == effect for e in s.effects)]
        needed = [s for s in stages if s.name not in self.gone]
        drawn = [w.name for s in needed for w in s.writes if w.when == effect]
        if not needed:
            return f"{' and '.join(s.name for s in stages)} {'is' if len(stages) == 1 else 'are'} not needed"
        used = any(w in self.read for w in drawn) or any(all(w.when != effect for w in s.writes) for s in needed)
        return None if used else f"no stage reads {' and '.join(drawn)} under these settings"


def decided_facts(capture: Facts, found: Verdicts) -> Facts:
    """Facts of the capture, the effects that are not off, and what choices came to."""
    on = {name for name, v in found.effects.items() if v.state != "off"}
    return capture | on | {v.picked.fact for v in found.choices.values() if v.picked}


def with_optional(params: Callable[[Stage], Any], known: Facts) -> Facts:
    """With the optional stages that are needed."""
    return known | {s.name for s in STAGES if s.optional and s.unneeded(params(s), known) is None}


def useful(
    evidence_of: Callable[[str], Evidence],
    settings: Any,
    params: Callable[[Stage], Any],
    capture: Facts,
    asked: frozenset[str],
) -> Verdicts:
    """`judged`, where an effect that nobody has a use for is off, and one whose use follows from an open choice waits
    for it. `capture`: the facts of the capture; `asked` as in `Demand.of`."""
    idle: dict[str, Idle] = {}
    while True:
        found = judged(evidence_of, settings, idle)
        more = {n: i for n, i in idle_effects(params, capture, found, asked).items() if n not in idle}
        if not more:
            return found
        idle |= more


def perhaps_gone(
    params: Callable[[Stage], Any], capture: Facts, found: Verdicts, asked: frozenset[str]
) -> frozenset[str]:
    """Stages that are not needed under some answer to what is undecided. `capture`, `asked` as of `useful`."""
    effects = {name for name, v in found.effects.items() if v.state == "undecided"}
    known = decided_facts(capture, found) - effects
    answers = [fact for v in found.choices.values() if v.picked is None for fact in v.choice.facts]
    under = [known | {fact} for fact in answers] or [known]
    return frozenset(s for facts in under for s in Demand.of(params, with_optional(params, facts), asked).gone)


def idle_effects(
    params: Callable[[Stage], Any], capture: Facts, found: Verdicts, asked: frozenset[str]
) -> dict[str, Idle]:
    """Effects that are not off and that nobody has a use for, whatever open choices come to; and those that nobody
    may have a use for, with what tells. `asked` as in `Demand.of`."""
    known = decided_facts(capture, found)
    waiting = [v for v in found.choices.values() if v.picked is None]
    answers = [(known | {fact}, v.asks) for v in waiting for fact in v.choice.facts] or [(known, ())]
    under = [(Demand.of(params, with_optional(params, facts), asked), asks) for facts, asks in answers]
    idle: dict[str, Idle] = {}
    for name in (n for n, v in found.effects.items() if v.state != "off"):
        told = [(why, asks) for demand, asks in under if (why := demand.idle(name)) is not None]
        if told:
            waits = dict.fromkeys(a for _, asks in told for a in asks) if len(told) < len(under) else {}
            idle[name] = Idle(told[0][0], tuple(waits))
    return idle
