"""The settings below `effects`: auto, on or off for every effect that a stage declares."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, create_model, field_validator

from posegaussian.stages.contract.declaration import Effect
from posegaussian.stages.registry import STAGES

Setting = Literal["auto", "on", "off"]


class _Effects(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    @field_validator("*", mode="before")
    @classmethod
    def _words_that_yaml_takes_for_truth_values(cls, value: Any) -> Any:
        return {True: "on", False: "off"}[value] if isinstance(value, bool) else value


def declared() -> dict[str, tuple[Effect, tuple[str, ...]]]:
    """{name: (effect, stages that declare it)}, in the order of flow."""
    found: dict[str, tuple[Effect, tuple[str, ...]]] = {}
    for stage in STAGES:
        for e in stage.effects:
            found[e.name] = (e, (*found.get(e.name, (e, ()))[1], stage.name))
    return found


EffectSettings: Any = create_model("EffectSettings", __base__=_Effects, **dict.fromkeys(declared(), (Setting, "auto")))  # type: ignore[call-overload]
"""One field an effect: auto | on | off."""
