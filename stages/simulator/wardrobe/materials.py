"""What surfaces are made of, as far as light is concerned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Material:
    """How a surface mirrors; it does so where the effect `specular` is on."""

    gloss: float
    """Share of a lamp's light mirrored face-on."""
    exponent: float
    """Sharpness of the highlight (Blinn-Phong)."""
    sheen: float = 0.0
    """Share of Fresnel's reflection of sky and ground that is left: 0 rough cloth, 1 polished."""


MATERIALS: dict[str, Material] = {
    "cotton": Material(0.02, 20.0),
    "satin": Material(0.08, 12.0, 0.15),
    "leather": Material(0.05, 28.0, 0.35),
    "lacquer": Material(0.06, 140.0, 0.8),
    "metal": Material(0.45, 50.0, 0.6),
}
"""{name: material}. Face-on, polished dielectrics mirror 4 % (refractive index 1.5)."""


def three(colors: tuple[tuple[int, int, int], ...]) -> tuple[Any, Any, Any]:
    """Three colours of up to three: the last one is repeated."""
    return colors[0], colors[min(1, len(colors) - 1)], colors[-1]
