"""People work together: a second person stands near the main one, is seen in the pictures and belongs to no mask."""

from __future__ import annotations

from typing import Any

from pydantic import Field, field_validator

from posegaussian.stages.contract.declaration import Decision, Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, SceneEvidence, above, generator
from posegaussian.stages.simulator.subjects.motion_names import MOTION_NAMES
from posegaussian.stages.simulator.subjects.splits import cast, casting


class SecondPerson(EffectParams):
    """Where, and what they do."""

    position: tuple[float, float] = Field((-0.25, 0.85), description="Where they stand, metres.")
    velocity: tuple[float, float] = Field((0.0, 0.0), description="Metres a second that they move on from there.")
    heading: float = Field(-70.0, description="Degrees they are turned to the left.")
    motion: str = Field("stand", description="Name of a motion.")

    @field_validator("motion")
    @classmethod
    def _known_motion(cls, value: str) -> str:
        if value not in MOTION_NAMES:
            raise ValueError(f"there is no motion {value!r}; there are {', '.join(MOTION_NAMES)}")
        return value


def _decide(evidence: SceneEvidence, bound: float) -> Decision:
    x, y = evidence.params.position
    return above(1.0, bound, f"somebody else stands at ({x:g}, {y:g}) and does {evidence.params.motion}")


def _others(names: tuple[str, ...], main: str) -> tuple[str, ...]:
    return tuple(n for n in names if n != main) or names


def apply(params: Any, seed: int) -> Any:
    """The second person, drawn by the seed among the other subjects and outfits that the scene's seed allows."""
    from posegaussian.stages.simulator.wardrobe.actors import Performer

    random, allowed = generator(seed, "second_person"), casting(seed)
    who, what = (
        names[int(random.integers(len(names)))]
        for names in (_others(n, main) for n, main in zip((allowed.subjects, allowed.outfits), cast(seed), strict=True))
    )
    return Performer(
        who,
        what,
        params.motion,
        1.0,
        0.4,
        random.uniform(-1, 1, 4),
        params.heading,
        tuple(params.position),
        tuple(params.velocity),
    )


EFFECT = SceneEffect(
    Effect("second_person", "Let somebody else into the picture.", "other people", 0.0, "1", _decide),
    SecondPerson,
    "meshes",
    "posegaussian.stages.simulator.effects.second_person:apply",
    35.0,
)
