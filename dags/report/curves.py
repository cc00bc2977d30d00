"""Curves over time as inline SVG: a page of a hundred sequences has hundreds of them, at about a kilobyte each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 320, 150, 46, 20, 8
"""Size of a plot and its margins, in units of its view box: two fit a page's width, one a phone's."""
MOST_POINTS = 200
"""Points of a curve; of more, evenly spread ones are drawn: no screen shows more on this width."""
COLORS = ("#286e96", "#d73c2d", "#2f8f4e", "#8a4fa3")
"""Of curves that share a plot, in order, then again."""


def plot(title: str, curves: Mapping[str, Sequence[tuple[float, float]]]) -> str:
    """An SVG figure of {name: (frame, value)}; a curve of one point is a dot. Nothing finite to show: nothing."""
    finite = {name: [p for p in points if np.isfinite(p).all()] for name, points in curves.items()}
    finite = {name: _thinned(sorted(points)) for name, points in finite.items() if points}
    if not finite:
        return ""
    every = np.array([p for points in finite.values() for p in points], float)
    (x0, y0), (x1, y1) = every.min(axis=0), every.max(axis=0)
    drawn = "".join(
        _curve(name, [_at(p, (x0, x1), (y0, y1)) for p in points], COLORS[i % len(COLORS)])
        for i, (name, points) in enumerate(finite.items())
    )
    key = "".join(
        f'<span style="color:{COLORS[i % len(COLORS)]}">{escape(name)}</span> ' for i, name in enumerate(finite)
    )
    return (
        f'<figure class="plot"><figcaption><b>{escape(title)}</b> {key}</figcaption>'
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title, quote=True)}">'
        f"{_axes((x0, x1), (y0, y1))}{drawn}</svg></figure>"
    )


def _axes(across: tuple[float, float], up: tuple[float, float]) -> str:
    """The two lines and what stands at their ends; a value alone stands where `_at` has it, once."""
    (x0, x1), (y0, y1), right, floor = across, up, WIDTH - 8, HEIGHT - BOTTOM
    values = [(TOP + 9, y1), (floor, y0)] if y1 > y0 else [((TOP + floor) // 2 + 4, y0)]
    first, last = f"frame {x0:g}", f'<text x="{right}" y="{HEIGHT - 5}" text-anchor="end">{x1:g}</text>'
    frames = (
        f'<text x="{LEFT}" y="{HEIGHT - 5}">{first}</text>{last}'
        if x1 > x0
        else f'<text x="{(LEFT + right) // 2}" y="{HEIGHT - 5}" text-anchor="middle">{first}</text>'
    )
    return (
        f'<path d="M{LEFT} {TOP}V{floor}H{right}" fill="none" stroke="#9aa2ac"/>'
        + "".join(f'<text x="{LEFT - 5}" y="{y}" text-anchor="end">{value:.3g}</text>' for y, value in values)
        + frames
    )


def _thinned(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    if len(points) <= MOST_POINTS:
        return points
    return [points[i] for i in np.linspace(0, len(points) - 1, MOST_POINTS).round().astype(int)]


def _at(point: tuple[float, float], across: tuple[float, float], up: tuple[float, float]) -> str:
    """Where a point lies in the view box; one value alone lies in the middle."""
    x, y = (
        (value - low) / (high - low) if high > low else 0.5
        for value, (low, high) in zip(point, (across, up), strict=True)
    )
    return f"{LEFT + 6 + x * (WIDTH - LEFT - 20):.1f},{HEIGHT - BOTTOM - 6 - y * (HEIGHT - BOTTOM - TOP - 12):.1f}"


def _curve(name: str, places: Sequence[str], color: str) -> str:
    said = f"<title>{escape(name)}</title>"
    if len(places) == 1:
        x, y = places[0].split(",")
        return f'<circle cx="{x}" cy="{y}" r="3" fill="{color}">{said}</circle>'
    return f'<polyline points="{" ".join(places)}" fill="none" stroke="{color}" stroke-width="1.6">{said}</polyline>'
