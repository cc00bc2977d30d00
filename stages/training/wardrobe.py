"""What people of training scenes wear and hold as captured people do: dark, glossy and printed cloth, folds, straps,
things in hands, loose hair."""

from __future__ import annotations

from typing import Any

import numpy as np

from posegaussian.stages.simulator.wardrobe.description import CLOTH_PATTERNS
from posegaussian.stages.simulator.wardrobe.materials import MATERIALS

OWN_CLOTH, FOLDED = 0.6, 0.5
"""Share of the garments that are not the outfit's, and of all that have folds."""
DARK = 0.5
"""Share of such cloth that is nearly black: sRGB bytes under 60."""
STRAPPED, CARRYING, LOOSE = 0.4, 0.3, 0.4
"""Share of the people with straps, with a thing in a hand, and with loose hair."""
STRAPS = ("sash", "harness", "belt", "thighs", "bracers")
THINGS = ("helmet", "bag", "board")


def extras(random: np.random.Generator) -> dict[str, Any]:
    """Fields of a scene's subject, by chance."""
    found: dict[str, Any] = {"upper": _cloth(random), "lower": _cloth(random)}
    if random.random() < STRAPPED:
        kinds = random.permutation(STRAPS)[: int(random.integers(1, 4))]
        found["straps"] = [
            {"kind": str(k), "width": float(random.uniform(0.02, 0.07)), "color": _color(random), **_material(random)}
            for k in kinds
        ]
    if random.random() < CARRYING:
        hand = ("left", "right")[int(random.integers(2))]
        found["carries"] = [{"thing": THINGS[int(random.integers(len(THINGS)))], "hand": hand, **_material(random)}]
    if random.random() < LOOSE:
        found["hair"] = {
            "strands": int(random.integers(500, 6000)),
            "length": float(random.uniform(0.03, 0.25)),
            "loose": float(random.uniform(0.1, 0.9)),
        }
    return found


def _cloth(random: np.random.Generator) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if random.random() < OWN_CLOTH:
        found |= {
            "pattern": CLOTH_PATTERNS[int(random.integers(len(CLOTH_PATTERNS)))],
            "colors": [_color(random) for _ in range(3)],
            "scale": float(np.exp(random.uniform(np.log(0.01), np.log(0.3)))),
            **_material(random),
        }
    if random.random() < FOLDED:
        found["folds"] = float(random.uniform(0.002, 0.015))
    return found


def _color(random: np.random.Generator) -> list[int]:
    most = 60 if random.random() < DARK else 256
    return [int(c) for c in random.integers(0, most, 3)]


def _material(random: np.random.Generator) -> dict[str, str]:
    return {"material": tuple(MATERIALS)[int(random.integers(len(MATERIALS)))]}
