"""What was decided of a sequence's effects, kept as settings, and which of them could have been decided otherwise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.effects import EffectVerdict
from posegaussian.dags.tradeoff.tradeoff import level_settings
from posegaussian.stages.registry import STAGES
from posegaussian.storage.model.errors import ConfigError

State = Literal["on", "off"]


@dataclass(frozen=True, eq=False)
class Switch:
    """One effect that may be on or off on this capture."""

    name: str
    """Of the effect."""
    decided: State
    """What it is."""
    measured: str
    """`0.31 of 0.25 px/px`: what was measured and the bound; empty where nothing was."""

    @property
    def other(self) -> State:
        """What it is not."""
        return "off" if self.decided == "on" else "on"

    @classmethod
    def of(cls, verdict: EffectVerdict) -> Switch:
        """From what is known of the effect; text alone, so that it may leave the process."""
        decision, effect = verdict.decision, verdict.effect
        assert decision is not None, f"{effect.name} is decided before it is turned"
        bound = effect.quantity(f"{effect.threshold:g}")
        told = "" if decision.measured is None else f"{decision.measured:.3g} of {bound}"
        return cls(effect.name, "on" if decision.on else "off", told)


def pinned(context: Context) -> dict[str, Any]:
    """{`effects.NAME` or `stage.setting`: what it came to} of every effect and every choice left to `auto`, so that
    one can be turned without another following."""
    found: dict[str, Any] = {f"effects.{name}": v.state for name, v in context.effects.items()}
    for stage in STAGES:
        params = context.params(stage)
        for choice in stage.choices:
            if getattr(params, choice.setting) == "auto":
                found[f"{stage.name}.{choice.setting}"] = choice.resolve(params, context.facts)[0]
    return found


def switches(context: Context) -> tuple[list[Switch], dict[str, str]]:
    """The effects that could be what they are not, in the order of flow, and {effect: why} of those that cannot.

    All else stays as it was decided. The context's decisions are made: nothing of it is undecided.
    """
    fixed, found, ruled_out = pinned(context), [], {}
    for name, verdict in context.effects.items():
        assert verdict.decision is not None, f"{name} is decided before it is turned"
        switch = Switch.of(verdict)
        trial = replace(context, settings=level_settings(context, {**fixed, f"effects.{name}": switch.other}))
        turned = trial.effects[name]
        if turned.state == switch.decided:
            ruled_out[name] = verdict.decision.reason
        elif refusals := trial.refusals():
            ruled_out[name] = refusals[0]
        else:
            found.append(switch)
    return found, ruled_out


def decided(context: Context) -> Context:
    """The context, when nothing of it is open. Raises ConfigError for what is: a stage that decides did not run."""
    if names := [v.effect.name for v in context.effects.values() if v.state == "undecided"]:
        raise ConfigError(f"effects --regret: {', '.join(names)} cannot be decided on these frames; set them on or off")
    return context
