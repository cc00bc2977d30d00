"""The picture of a trade-off: seconds a frame against each measure, the Pareto front marked, every point named."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from posegaussian.dags.tradeoff.pareto import Level, front

WIDTH, HEIGHT = 640, 460
"""One panel, px."""
LEFT, RIGHT, UNDER, ABOVE = 86, 24, 66, 40
"""Borders of the plot inside its panel, px."""
HEAD, LINE = 84, 24
"""Height of the title and of one line of the list, px."""
INK, FAINT, GRID, FRONT, OTHER = (40, 32, 24), (110, 104, 98), (226, 222, 218), (45, 60, 215), (176, 160, 140)
"""Colours as (blue, green, red)."""
TITLES = {
    "psnr box": "PSNR in the mask's box, dB (higher is better)",
    "ssim box": "SSIM in the mask's box (higher is better)",
    "epe": "EPE of the depth, px (lower is better)",
}
"""Panels, in order; one whose measure is missing is left out."""
LOGARITHMIC = 6.0
"""Ratio of the dearest to the cheapest level above which seconds are drawn on a logarithmic axis."""


def draw(file: Path, levels: Sequence[Level], what: str, where: str) -> None:
    """Write the PNG: a panel a measure, below them the list of levels by number, cheapest first.

    `what` and `where` are the two lines of the title: sequence and machine.
    """
    import cv2

    from posegaussian.storage.readers.images import write_png

    measures = [m for m in TITLES if all(m in level.quality for level in levels)]
    page = np.full((HEAD + HEIGHT + LINE * (len(levels) + 2), max(2, len(measures)) * WIDTH, 3), 255, np.uint8)
    _write(page, "What quality costs: " + what, (24, 34), 0.62, bold=True)
    _write(page, f"{where}.  Red: on the Pareto front", (24, 62), 0.5, FAINT)
    cost = [level.total for level in levels]
    for i, m in enumerate(measures):
        panel = page[HEAD : HEAD + HEIGHT, i * WIDTH : (i + 1) * WIDTH]
        _panel(panel, cost, [level.quality[m] for level in levels], front(levels, m), TITLES[m])
    y = HEAD + HEIGHT + LINE
    for i, (level, on_front) in enumerate(zip(levels, front(levels, measures[0]), strict=True)):
        text = f"{i + 1:>2}  {level.label()}:  {level.total:.3g} s a frame,  " + ",  ".join(
            f"{m} {level.quality[m]:.4g}" for m in measures
        )
        _write(
            page, text + (f"   (front of {measures[0]})" if on_front else ""), (48, y), 0.5, INK if on_front else FAINT
        )
        cv2.circle(page, (32, y - 5), 6, FRONT if on_front else OTHER, -1, cv2.LINE_AA)
        y += LINE
    write_png(file, np.ascontiguousarray(page[..., ::-1]))


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """At most `most` + 1 round numbers (1, 2 or 5 times a power of ten apart) within [low, high]."""
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    step = next(step * k for k in (1, 2, 5, 10) if (high - low) / (step * k) <= most)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten within [low, high]."""
    return [
        v
        for e in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        for k in (1, 2, 5)
        if low <= (v := k * 10.0**e) <= high
    ]


def _panel(
    panel: np.ndarray, cost: Sequence[float], value: Sequence[float], on_front: Sequence[bool], title: str
) -> None:
    """One plot: axes, grid, front, points."""
    import cv2

    logarithmic = max(cost) > LOGARITHMIC * min(cost)
    x_range, y_range = _widened(cost, logarithmic), _widened(value, False)

    def place(x: float, y: float) -> tuple[int, int]:
        share = (
            (math.log(x / x_range[0]) / math.log(x_range[1] / x_range[0]))
            if logarithmic
            else (x - x_range[0]) / (x_range[1] - x_range[0])
        )
        height = (y - y_range[0]) / (y_range[1] - y_range[0])
        return round(LEFT + share * (WIDTH - LEFT - RIGHT)), round(HEIGHT - UNDER - height * (HEIGHT - ABOVE - UNDER))

    for t in log_ticks(*x_range) if logarithmic else ticks(*x_range):
        x, _ = place(t, y_range[0])
        cv2.line(panel, (x, ABOVE), (x, HEIGHT - UNDER), GRID, 1)
        _write(panel, f"{t:.3g}", (x, HEIGHT - UNDER + 22), 0.48, centred=True)
    for t in ticks(*y_range):
        _, y = place(x_range[0], t)
        cv2.line(panel, (LEFT, y), (WIDTH - RIGHT, y), GRID, 1)
        _write(panel, f"{t:.6g}", (LEFT - 10, y + 5), 0.48, right=True)
    cv2.rectangle(panel, (LEFT, ABOVE), (WIDTH - RIGHT, HEIGHT - UNDER), INK, 1)
    _write(panel, title, (LEFT, ABOVE - 12), 0.52, bold=True)
    _write(
        panel,
        "seconds a frame, all stages" + (" (logarithmic)" if logarithmic else ""),
        ((LEFT + WIDTH - RIGHT) // 2, HEIGHT - 18),
        0.5,
        centred=True,
    )
    points = [place(c, v) for c, v in zip(cost, value, strict=True)]
    line = sorted(p for p, f in zip(points, on_front, strict=True) if f)
    if len(line) > 1:
        cv2.polylines(panel, [np.array(line)], False, FRONT, 2, cv2.LINE_AA)
    for p, f in zip(points, on_front, strict=True):
        cv2.circle(panel, p, 7, FRONT if f else OTHER, -1, cv2.LINE_AA)
    for number, spot in enumerate(labels(points), start=1):
        _write(panel, str(number), spot, 0.46, bold=True, centred=True)


def _widened(values: Sequence[float], logarithmic: bool) -> tuple[float, float]:
    """The range of an axis: that of the values and a tenth more on both sides."""
    low, high = min(values), max(values)
    if logarithmic:
        margin = (high / low) ** 0.1
        return low / margin, high * margin
    margin = 0.1 * (high - low) or 0.05 * abs(high) or 0.5
    return low - margin, high + margin


def labels(points: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Where the number of each point goes: above it, or on the side where no other point or number is."""
    around = ((0, -12), (0, 24), (17, 5), (-17, 5), (16, -10), (-16, -10), (16, 20), (-16, 20), (0, -28), (0, 40))
    taken = list(points)
    found = []
    for x, y in points:
        spots = [(x + dx, y + dy) for dx, dy in around]
        best = max(
            spots,
            key=lambda s: (
                min(min((math.hypot(s[0] - a, s[1] - 5 - b) for a, b in taken if (a, b) != (x, y)), default=99.0), 15.0)
                - 0.01 * spots.index(s)
            ),
        )
        taken.append((best[0], best[1] - 5))
        found.append(best)
    return found


def _write(
    page: np.ndarray,
    text: str,
    at: tuple[int, int],
    size: float,
    color: tuple[int, int, int] = INK,
    bold: bool = False,
    centred: bool = False,
    right: bool = False,
) -> None:
    """One line of text; `at` is its lower left corner, its lower middle or its lower right."""
    import cv2

    font, weight = cv2.FONT_HERSHEY_SIMPLEX, 2 if bold and size > 0.6 else 1
    (width, _), _ = cv2.getTextSize(text, font, size, weight)
    x = at[0] - (width // 2 if centred else width if right else 0)
    cv2.putText(page, text, (x, at[1]), font, size, color, weight, cv2.LINE_AA)
