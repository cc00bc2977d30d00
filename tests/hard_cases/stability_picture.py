"""The picture of the catalogue: every case's errors on one logarithmic axis, and what some of them look like."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from posegaussian.dags.charts.style import FAINT, GREEN, GRID, INK, RED, chart, heading
from tests.hard_cases.catalogue import Case, Outcome
from tests.hard_cases.thumbnails import Pair, thumbnails

WIDTH, ROW, HEAD, TILE = 11.5, 0.195, 1.2, 1.45
"""Inches: the page, one case, everything above the first, a line of the gallery."""
LEAST, MOST = -17, 11
"""Powers of ten of the axis; beyond, a mark stands on its end."""
ZERO, BROKEN = LEAST - 2.5, MOST + 2
"""Where on the axis exactly 0 stands, and what is no number."""
NAMES = 345
"""Points from a case's name to the axis; its words stand between."""
PER_LINE = 4
"""Pairs of pictures side by side."""


def draw(file: Path, rows: Sequence[tuple[Case, Outcome]]) -> None:
    """Write the PNG."""
    pairs = thumbnails()
    lines = math.ceil(len(pairs) / PER_LINE)
    heights = [HEAD + ROW * len(rows), 0.4 + TILE * lines]
    with chart(file, WIDTH, sum(heights)) as figure:
        parts: Any = figure.subfigures(2, 1, height_ratios=heights)
        upper, lower = parts
        heading(upper, "Worst error of every hard case, naive and ours, against the promised bound", weight="bold")
        _errors(upper.subplots(), rows)
        heading(lower, "What some of them look like; pink is no number", 10.5, weight="bold")
        _gallery(lower.subplots(lines, 2 * PER_LINE, squeeze=False), pairs)


def _errors(axes: Axes, rows: Sequence[tuple[Case, Outcome]]) -> None:
    """A line a case: the span between its two errors, the bound, the errors."""
    places = range(len(rows))
    ours, bounds = [_place(o.ours) for _, o in rows], [_place(c.bound) for c, _ in rows]
    naive = [_place(o.naive) for _, o in rows]
    number = [math.isfinite(o.naive) for _, o in rows]
    axes.hlines(places, ours, naive, color="#cfd3d6", linewidth=1)
    axes.plot(naive, places, "o", color=RED, label="naive", markevery=number)
    axes.plot(naive, places, "x", color=RED, markeredgewidth=2, markevery=[not n for n in number])
    axes.plot(ours, places, "o", color=GREEN, label="ours", zorder=3)
    axes.plot(bounds, places, "|", color=INK, label="bound", markersize=10, markeredgewidth=2)
    for y, (_, outcome) in enumerate(rows):
        if not number[y]:
            axes.text(BROKEN + 0.5, y, _no_number(outcome), color=RED, size=8, va="center")
    powers = range(LEAST + 1, MOST + 1, 4)
    axes.set_xticks([ZERO, *powers, BROKEN], ["0", *(f"1e{p}" for p in powers), "no number"], color=FAINT)
    axes.set_yticks(places, [f"{c.title}  [{c.unit}]" for c, _ in rows], color=FAINT, size=8.5, ha="left")
    axes.tick_params("y", pad=NAMES - 30)
    for y, (case, _) in enumerate(rows):
        axes.annotate(case.name, (0, y), (-NAMES, 0), ("axes fraction", "data"), "offset points", va="center", size=8.5)
    axes.xaxis.tick_top()
    axes.set(xlim=(ZERO - 1, BROKEN + 4), ylim=(len(rows) - 0.4, -0.6))
    axes.grid(axis="y", color=GRID, linewidth=0.4)
    axes.spines[:].set_visible(False)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1.012), ncols=3, borderaxespad=0)


def _no_number(outcome: Outcome) -> str:
    return "raises" if outcome.raised else "NaN" if math.isnan(outcome.naive) else "infinite"


def _place(value: float) -> float:
    """Where an error stands on the axis: its power of ten."""
    if value == 0:
        return ZERO
    return min(max(math.log10(value), LEAST), MOST) if math.isfinite(value) else BROKEN


def _gallery(places: Any, pairs: Sequence[Pair]) -> None:
    """Pairs of pictures, naive and ours, with the case's name."""
    for axes in places.flat:
        axes.set_axis_off()
    for n, (title, *pictures) in enumerate(pairs):
        left = places[n // PER_LINE, 2 * (n % PER_LINE) :]
        left[0].set_title(title, size=8.5, weight="normal")
        for axes, picture, name, color in zip(left, pictures, ("naive", "ours"), (RED, GREEN), strict=False):
            axes.imshow(picture, interpolation="nearest")
            axes.text(0, -0.04, name, color=color, size=8.5, va="top", transform=axes.transAxes)
