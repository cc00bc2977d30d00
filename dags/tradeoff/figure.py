"""The picture of a trade-off: seconds a frame against each measure, the Pareto front marked, every point named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from posegaussian.dags.charts.style import FAINT, GREY, GRID, INK, RED, chart, heading, name_points, seconds_axis
from posegaussian.dags.tradeoff.pareto import QUALITIES, Level, front

PANELS = [name for name, q in QUALITIES.items() if q.drawn]
"""Measures that have a panel, in order; one whose measure is missing is left out."""
WIDTH, PANEL, HEAD, LINE, LETTER = 4.2, 3.9, 0.7, 0.23, 0.085
"""Inches: width and height of a panel, height of the title and of a line of the table, width of a letter."""


def draw(file: Path, levels: Sequence[Level], what: str, where: str) -> None:
    """Write the PNG: a panel a measure, below them the table of levels by number, cheapest first.

    `what` and `where` are the two lines of the title: sequence and machine. Raises NotWritten.
    """
    measures = [m for m in PANELS if all(m in level.quality for level in levels)]
    fronts = {m: front(levels, m) for m in measures}
    heights = [HEAD + PANEL, LINE * (len(levels) + 1.6)]
    needed = LETTER * sum(len(knob) + 4 for knob in levels[0].values) + 4
    with chart(file, max(WIDTH * max(2, len(measures)), needed), sum(heights)) as figure:
        heading(figure, "What quality costs: " + what, weight="bold")
        parts: Any = figure.subfigures(2, 1, height_ratios=heights)
        upper, lower = parts
        heading(upper, f"{where}. Red: on the Pareto front. Numbers: the lines of the table", 9.5, color=FAINT)
        for m, axes in zip(measures, upper.subplots(1, len(measures), squeeze=False)[0], strict=True):
            _panel(axes, levels, m, fronts[m])
        below = lower.subplots()
        for m, axes in zip(measures, upper.axes, strict=True):
            colors = [INK if on else FAINT for on in fronts[m]]
            name_points(axes, _points(levels, m), [str(i + 1) for i in range(len(levels))], colors, size=8)
        _table(below, levels, fronts)  # last: to find room for the names all else is laid out


def _points(levels: Sequence[Level], measure: str) -> list[tuple[float, float]]:
    return [(level.total, level.quality[measure]) for level in levels]


def _panel(axes: Axes, levels: Sequence[Level], measure: str, on_front: Sequence[bool]) -> None:
    """One plot: axes, front, points."""
    points = _points(levels, measure)
    kept = sorted(p for p, on in zip(points, on_front, strict=True) if on)
    others = [p for p, on in zip(points, on_front, strict=True) if not on]
    axes.plot(*zip(*kept, strict=True), "o-", color=RED, markeredgecolor="white", markersize=8, zorder=3)
    if others:
        axes.plot(*zip(*others, strict=True), "o", color=GREY, markeredgecolor="white", markersize=8, zorder=2)
    quality = QUALITIES[measure]
    axes.set_title(quality.title)
    seconds_axis(axes, "seconds a frame, all stages", [level.total for level in levels])
    axes.set_ylabel(f"{quality.axis} ({quality.better} is better)")
    axes.margins(0.09)


def _table(axes: Axes, levels: Sequence[Level], fronts: dict[str, list[bool]]) -> None:
    """The levels by number; a measure is red where its level is on that measure's front."""
    knobs = list(levels[0].values)
    heads = ["", *knobs, "s a frame", *(QUALITIES[m].axis for m in fronts)]
    cells = [
        [
            str(i + 1),
            *(level.value_text(k) for k in knobs),
            _digits(level.total, 3),
            *(_digits(level.quality[m], 4) for m in fronts),
        ]
        for i, level in enumerate(levels)
    ]
    axes.set_axis_off()
    table: Any = axes.table(cells, colLabels=heads, cellLoc="left", colLoc="left", edges="B", bbox=Bbox.unit())
    table.auto_set_font_size(False)
    table.auto_set_column_width(list(range(len(heads))))
    table.set_in_layout(False)
    first = 2 + len(knobs)
    for (row, column), cell in table.get_celld().items():
        cell.set_edgecolor(GRID)
        on = row > 0 and column >= first and list(fronts.values())[column - first][row - 1]
        cell.set_text_props(size=9, color=RED if on else FAINT if row == 0 else INK, weight="bold" if on else "normal")


def _digits(value: float, digits: int) -> str:
    """So many digits, with the zeros at the end: they are known, too."""
    return f"{value:#.{digits}g}".rstrip(".")
