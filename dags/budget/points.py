"""Settings from cheap to dear, of those measured that no other is both faster and better than
(docs/measurements/tradeoff.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Point:
    """One of them."""

    name: str
    told: str
    """What it does, in a few words."""
    against: float
    """Box PSNR against the default's, dB: mean over simulated people that nothing was tuned on, of
    `python -m benchmarks.quality.front`. Of a front that was measured on a sequence: against the best on it."""
    seconds: float
    """CPU seconds a frame there: how much longer one point takes than another, wherever it runs."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """{stage.key: value}; what is not named stays as it is set."""
    size: float = 1.0
    """Share of the pictures' longest side that is kept."""
    measured: str | None = None
    """What was measured of it where that was on a sequence of the user's."""
    reached: float | None = None
    """Box PSNR of held-out cameras there, dB; None where all else was set otherwise."""

    @property
    def knobs(self) -> frozenset[str]:
        """The stage.key that it sets."""
        return frozenset(self.values(1))

    @property
    def worth(self) -> str:
        """Its quality, in words."""
        return self.measured or f"{self.against:+.1f} dB against the default on simulated people"

    def values(self, longest: int) -> dict[str, Any]:
        """{stage.key: value} for pictures of `longest` px."""
        return {**self.settings, **({"frames.size": max(1, round(self.size * longest))} if self.size < 1 else {})}


def _floor(depth: str, steps: int) -> dict[str, Any]:
    return {"depth.method": depth, "network.weights": "none", "refinement.steps": steps}


def _learned(depth: str, steps: int) -> dict[str, Any]:
    return {"depth.method": depth, "network.weights": "auto", "refinement.steps": steps}


POINTS = (
    Point("preview", "half size, depth from silhouettes alone", -7.0, 0.9, _floor("hull", 0), 0.5),
    Point("half, matched", "half size, matched depth, 20 steps of refinement", -3.1, 2.2, _floor("sweep", 20), 0.5),
    Point("3/4, matched", "three quarters of the size, matched depth, 20 steps", -2.0, 4.35, _floor("sweep", 20), 0.75),
    Point("3/4, learned", "three quarters, matched depth, network, 20 steps", -1.3, 5.77, _learned("sweep", 20), 0.75),
    Point("3/4, finer", "three quarters, matched depth, network, 50 steps", -0.9, 7.31, _learned("sweep", 50), 0.75),
    Point("learned", "matched depth, network, 20 steps of refinement", -0.6, 10.0, _learned("sweep", 20)),
    Point("learned, finer", "matched depth, network, 50 steps of refinement", -0.1, 12.7, _learned("sweep", 50)),
    Point(
        "balanced",
        "depth, network and steps of refinement by the judge",
        0.0,
        15.2,
        {**_learned("auto", 200), "refinement.worth": 0.05},
    ),
    Point(
        "dear",
        "depth and network by the judge, 200 steps of refinement",
        0.0,
        21.7,
        {**_learned("auto", 200), "refinement.worth": 0.0},
    ),
)
"""Cheapest first."""
PRESETS = ("preview", "balanced", "dear")
"""Points that are taken by name, with nothing measured."""


def preset(name: str) -> Point:
    """The preset of that name."""
    return next(p for p in POINTS if p.name == name)
