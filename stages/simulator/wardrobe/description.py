"""What a scene file may say of a person's cloth, straps, things in hands and hair.

What is left out is as the outfit and the subject have it, and costs nothing.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from posegaussian.stages.contract.declaration import Params
from posegaussian.stages.simulator.wardrobe.materials import MATERIALS

CLOTH_PATTERNS = ("plain", "stripes", "checks", "dots", "camouflage", "floral", "denim", "print")
"""Of `render.patterns.PATTERNS`, those that cloth may have."""
Byte = Annotated[int, Field(ge=0, le=255)]
Color = tuple[Byte, Byte, Byte]
Colors = Annotated[tuple[Color, ...], Field(min_length=1, max_length=3)]


def _known(kind: str, value: str, names: Any) -> str:
    if value not in names:
        raise ValueError(f"there is no {kind} {value!r}; there are {', '.join(names)}")
    return value


class _Surface(Params):
    @field_validator("material", check_fields=False)
    @classmethod
    def _known_material(cls, value: str | None) -> str | None:
        return None if value is None else _known("material", value, MATERIALS)

    @field_validator("pattern", check_fields=False)
    @classmethod
    def _known_pattern(cls, value: str | None) -> str | None:
        return None if value is None else _known("pattern", value, CLOTH_PATTERNS)


class Cloth(_Surface):
    """What a garment is made of, where that differs from the outfit."""

    pattern: str | None = Field(
        None, description="Name of a pattern; null: the outfit's, plain where `colors` has one."
    )
    colors: Colors | None = Field(None, description="Up to three sRGB colours in bytes; null: the outfit's.")
    scale: float | None = Field(None, gt=0.004, le=1, description="Period of the pattern; null: the outfit's.")
    material: str | None = Field(None, description="Name of a material; null: the outfit's cotton.")
    folds: float = Field(0.0, ge=0, le=0.03, description="How far folds stand out.")


class Strap(_Surface):
    """A band over the clothes."""

    kind: Literal["sash", "harness", "belt", "thighs", "bracers"] = Field(description="Where it runs.")
    width: float = Field(0.036, gt=0.004, le=0.15, description="Its width; bracers are four times as wide.")
    color: Color = Field((66, 42, 26), description="sRGB bytes.")
    material: str = Field("leather", description="Name of a material.")


class Carried(_Surface):
    """A thing in a hand."""

    thing: Literal["helmet", "bag", "board"] = Field(description="What it is.")
    hand: Literal["left", "right"] = Field("left", description="Which hand holds it.")
    pattern: str = Field("plain", description="Name of a pattern.")
    colors: Colors = Field(((58, 60, 64), (150, 120, 60), (24, 24, 26)), description="Up to three sRGB colours.")
    scale: float = Field(0.06, gt=0.004, le=1, description="Period of the pattern.")
    material: str = Field("satin", description="Name of a material.")


class Hair(Params):
    """Loose strands over the hair's shell: too thin for a pixel, so that outlines are soft."""

    strands: int = Field(0, ge=0, le=40_000, description="Number of strands; 0: the shell alone.")
    length: float = Field(0.06, gt=0, le=0.4, description="Of a strand.")
    width: float = Field(0.0016, gt=0, le=0.02, description="Of a strand at its root; it ends in a point.")
    tuft: int = Field(8, ge=1, le=200, description="Strands that run together.")
    loose: float = Field(0.5, ge=0, le=1, description="How far strands stand off: 0 they lie, 1 they stand up.")


class Extras(Params):
    """All of it."""

    upper: Cloth = Cloth.model_validate({})
    lower: Cloth = Cloth.model_validate({})
    straps: tuple[Strap, ...] = ()
    carries: tuple[Carried, ...] = ()
    hair: Hair = Hair.model_validate({})


NOTHING = Extras.model_validate({})
"""A person in nothing but the outfit."""
