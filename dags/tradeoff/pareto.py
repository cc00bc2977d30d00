"""The levels of a trade-off, and which of them no other one beats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from posegaussian.dags.planning.context import Context
from posegaussian.stages.metrics.measures.registry import METRICS


class Quality(NamedTuple):
    """What seconds are weighed against."""

    unit: str
    """"1" where there is none."""
    better: Literal["higher", "lower"]
    """Which values are good."""
    title: str
    """Its name, and of its panel in the figure."""
    axis: str
    """Of its axis, with the unit."""
    drawn: bool
    """Whether it has one."""


def _named(name: str, where: str, unit: str, better: Literal["higher", "lower"], drawn: bool = True) -> Quality:
    return Quality(unit, better, f"{name} {where}", name + ("" if unit == "1" else f", {unit}"), drawn)


QUALITIES = {
    f"{m.name} {region}": _named(m.title, where, m.unit, m.better, drawn=region == "box")
    for m in METRICS.values()
    if m.traded
    for region, where in (("box", "in the mask's box"), ("full", "of the full picture"))
} | {"epe": _named("EPE", "of the depth", "px", "lower")}
"""In the order they are shown."""


@dataclass
class Level:
    """One combination of the knobs' levels."""

    values: dict[str, Any]
    """{knob: value}."""
    context: Context
    """Its variant."""
    identities: dict[str, str] = field(default_factory=dict)
    """{stage: digest of the fingerprints of its tasks}: equal identity, equal output."""
    seconds: dict[str, float] = field(default_factory=dict)
    """{stage: seconds a frame}."""
    quality: dict[str, float] = field(default_factory=dict)
    """{measure: mean}."""

    @property
    def total(self) -> float:
        """Seconds a frame of all stages."""
        return sum(self.seconds.values())

    def label(self) -> str:
        """`depth.method=hull frames.size=128`."""
        return " ".join(f"{k}={self.value_text(k)}" for k in self.values)

    def value_text(self, knob: str) -> str:
        """`hull`; `full` of a size that is the capture's own."""
        value = self.values[knob]
        return "full" if value is None else str(value)


def pareto(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Of (cost, loss) pairs, both better when lower: whether no other point is as good in both and better in one."""
    return [not any(a <= x and b <= y and (a < x or b < y) for a, b in points) for x, y in points]


def front(levels: Sequence[Level], measure: str) -> list[bool]:
    """Which levels are on the Pareto front of seconds a frame against a measure."""
    sign = 1.0 if QUALITIES[measure].better == "lower" else -1.0
    return pareto([(level.total, sign * level.quality[measure]) for level in levels])
