"""The plan of a sequence as inline SVG: a line a stage in the order of flow, an arc from each to those that read it.

The chart of `posegaussian plan --picture` has a line an array and is for a sheet of paper; this one is read on a phone
and takes some kilobytes, a hundred times on a page.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from html import escape

from posegaussian.dags.diagnostics.plan_graph import COLORS, LEGEND, StageCard
from posegaussian.dags.humanize.text import seconds_text

ROW, TOP, WIDTH = 20, 12, 340
"""Height of a line, the first one's middle, and the width of the picture, in units of its view box."""
DOT, NAME, SECONDS, ARCS = 8, 18, 148, 158
"""Across: a stage's dot, its name, the end of its seconds, and where arcs begin."""
REACH = WIDTH - ARCS - 10
"""How far the longest arc swings out."""
FAILED = "#c92a2a"
"""Of a stage with a failed task."""


def flow(drawn: Sequence[StageCard], seconds: Mapping[str, float], failed: Collection[str]) -> str:
    """An SVG figure of the stages of one plan; `failed` are those with a failed task. Nothing to do: nothing."""
    if not any(card.counts for card in drawn):
        return ""
    colors = {c.name: FAILED if c.name in failed else COLORS[c.state] for c in drawn}
    lines = {c.name: TOP + ROW * i for i, c in enumerate(drawn)}
    read = {card.name: _reads(card) for card in drawn}
    longest = max((lines[reader] - lines[name] for name, readers in read.items() for reader in readers), default=ROW)
    arcs = "".join(_arcs(name, readers, lines, colors[name], longest) for name, readers in read.items())
    rows = "".join(_row(card, lines[card.name], colors[card.name], seconds.get(card.name)) for card in drawn)
    label = "stages of the plan, and which of them read what others make"
    return (
        f'<figure class="flow"><figcaption>{_legend(drawn, failed)}</figcaption>'
        f'<svg viewBox="0 0 {WIDTH} {TOP + ROW * len(drawn) - 8}" role="img" aria-label="{label}">{arcs}{rows}</svg>'
        "</figure>"
    )


def _row(card: StageCard, y: int, color: str, seconds: float | None) -> str:
    """A dot, hollow where the stage is not needed, its name and what it took."""
    inside = color if card.counts else "none"
    faint = "" if card.counts else ' class="faint"'
    took = f'<text x="{SECONDS}" y="{y + 4}" text-anchor="end">{seconds_text(seconds)}</text>' if seconds else ""
    return (
        f"<g{faint}><title>{escape(f'{card.name}: {card.words()}')}</title>"
        f'<circle cx="{DOT}" cy="{y}" r="5" fill="{inside}" stroke="{color}"/>'
        f'<text x="{NAME}" y="{y + 4}"><tspan class="name">{escape(card.name)}</tspan></text>{took}</g>'
    )


def _reads(card: StageCard) -> dict[str, list[str]]:
    """{stage that reads it: its arrays}, of those that are made."""
    found: dict[str, list[str]] = {}
    for array in card.arrays:
        for reader in array.readers if array.total else ():
            found.setdefault(reader, []).append(array.name)
    return found


def _arcs(name: str, readers: Mapping[str, Sequence[str]], lines: Mapping[str, int], color: str, longest: int) -> str:
    """From a stage to every one that reads it, the longer the wider; its title names the arrays."""
    found = ""
    for reader, arrays in readers.items():
        start, end = lines[name] + 3, lines[reader] - 3
        swing = round(ARCS + REACH * 4 / 3 * (end - start) / longest)  # a cubic reaches 3/4 of where it is drawn to
        said = escape(f"{name} → {reader}: {', '.join(arrays)}")
        found += (
            f'<g class="arc" style="color:{color}"><title>{said}</title>'
            f'<path d="M{ARCS} {start}C{swing} {start} {swing} {end} {ARCS} {end}"/>'
            f'<path class="tip" d="M{ARCS - 3} {end}l6 -3v6z"/></g>'
        )
    return found


def _legend(drawn: Sequence[StageCard], failed: Collection[str]) -> str:
    """What the colours say, of those that are there."""
    shown = {card.state for card in drawn if card.name not in failed}
    named = {COLORS[state]: meaning for state, meaning in LEGEND.items() if state in shown}
    named |= {FAILED: "failed"} if failed else {}
    return " ".join(f'<span style="color:{color}">●</span> {meaning}' for color, meaning in named.items())
