"""What an effect of a scene declares, and how it is decided:
the contract's `Effect`, with its settings and where it acts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Decision, Effect, Params

Phase = Literal[
    "rig",
    "calibration",
    "times",
    "meshes",
    "cloth",
    "shutter",
    "rows",
    "light",
    "gloss",
    "background",
    "optics",
    "sensor",
    "file",
    "mask",
    "joints",
]


class EffectParams(Params):
    """Settings of one effect."""

    switch: Literal["auto", "on", "off"] = Field("auto", description="auto: on where its measure is above the bound.")


@dataclass(frozen=True)
class SceneEvidence:
    """What a scene's decisions may look at."""

    params: Any
    """Settings of the effect."""
    exposure_motion: float
    """px the fastest joint moves between two frames, in the camera nearest to it."""
    picture: float
    """px, the longer side of the largest picture."""
    cameras: int
    """Number of cameras."""
    person: bool
    """Whether the subject is a baked person, with bones and loose cloth."""


@dataclass(frozen=True)
class SceneEffect:
    """One effect a scene may call for."""

    effect: Effect[SceneEvidence]
    """Name, summary, measure, bound and unit; `decide(SceneEvidence, bound)`."""
    params: type[EffectParams]
    """Its settings."""
    phase: Phase
    """Where it acts: in this order, and within a phase in the order of the registry."""
    apply: str
    """`module:function`; what it is given depends on the phase (`take.py`)."""
    milliseconds: float
    """What it costs a picture of 512 x 512 px, alone, by `python -m benchmarks.simulator.effects_time`; light is
    shared by the eight cameras of a frame."""

    @property
    def name(self) -> str:
        """Key below `effects` in a scene file."""
        return self.effect.name


@dataclass(frozen=True)
class Ruling:
    """Whether an effect of a scene is computed, and why."""

    effect: SceneEffect
    """Which."""
    params: Any
    """Its settings; None where the scene does not name it."""
    decision: Decision
    """On or off, and the reason."""


def ruled(effect: SceneEffect, params: Any, evidence: SceneEvidence) -> Ruling:
    """Decide one effect: off where the scene does not name it, else as switched, else by its measure."""
    bound = effect.effect.threshold
    if params is None:
        return Ruling(effect, None, Decision(False, None, bound, "the scene does not call for it"))
    lacking = effect.effect.lacks(evidence)
    if lacking is not None:
        return Ruling(effect, params, Decision(False, None, bound, lacking))
    measured = effect.effect.decide(evidence, bound)
    assert measured is not None
    if params.switch == "auto":
        return Ruling(effect, params, measured)
    return Ruling(
        effect,
        params,
        Decision(
            params.switch == "on", measured.measured, bound, f"the scene switches it {params.switch}; {measured.reason}"
        ),
    )


def above(measured: float, bound: float, sentence: str) -> Decision:
    """On where the measure is above the bound."""
    return Decision(bool(measured > bound), float(measured), bound, sentence)


def generator(seed: int, name: str, *where: int) -> np.random.Generator:
    """Random numbers of one effect at one place (frame, view, ...),
    whatever else is simulated and in whatever order."""
    return np.random.default_rng([seed, *name.encode(), *where])
