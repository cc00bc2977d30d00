"""The picture of a training: loss by step, and every validated measure; measures of one kind share a panel."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.tradeoff.figure import ticks
from posegaussian.stages.training.config import TrainingConfig

WIDTH, HEIGHT, ACROSS = 620, 360, 2
"""Of one panel, px; panels beside each other."""
LEFT, RIGHT, UNDER, ABOVE = 80, 24, 46, 52
"""Borders of the plot inside its panel, px."""
MOST = 8
"""Panels."""
SMOOTH = 50
"""Points into which the loss is averaged."""
INK, GRID, PHASE = (40, 32, 24), (226, 222, 218), (150, 140, 130)
COLORS = ((45, 60, 215), (150, 110, 40), (60, 150, 60), (160, 60, 160))
"""Of curves, as (blue, green, red)."""
Curve = list[tuple[float, float]]


def draw(file: Path, rows: Sequence[Mapping[str, Any]], config: TrainingConfig) -> None:
    """Write the PNG from the rows of a log; a grey line parts the phases."""
    import cv2

    from posegaussian.storage.readers.images import write_png

    panels = list(curves(rows).items())[:MOST]
    page = np.full((HEIGHT * math.ceil(len(panels) / ACROSS), WIDTH * ACROSS, 3), 255, np.uint8)
    last = max(row["step"] for row in rows)
    border = config.depth_steps if 0 < config.depth_steps < last else None
    for n, (title, panel_curves) in enumerate(panels):
        y, x = n // ACROSS * HEIGHT, n % ACROSS * WIDTH
        _panel(cv2, page[y : y + HEIGHT, x : x + WIDTH], title, panel_curves, last, border)
    write_png(file, np.ascontiguousarray(page[..., ::-1]))


def curves(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Curve]]:
    """{panel: {name: [(step, value)]}}: the training loss, averaged, and validated measures, those with one first
    word in one panel."""
    out: dict[str, dict[str, Curve]] = {}
    loss = [(float(r["step"]), float(r["loss"])) for r in rows if r["kind"] == "step" and r.get("loss") is not None]
    if loss:
        parts = np.array_split(np.array(loss), min(SMOOTH, len(loss)))
        out["loss in training"] = {"loss": [(float(s), float(v)) for s, v in (p.mean(axis=0) for p in parts)]}
    for row in rows:
        if row["kind"] == "validation":
            for key, value in row.items():
                if key not in ("kind", "step") and isinstance(value, int | float):
                    panel = out.setdefault(f"{re.split('[ _.]', key)[0]}, validated", {})
                    panel.setdefault(key, []).append((float(row["step"]), float(value)))
    return out


def _panel(
    cv2: Any, panel: np.ndarray, title: str, drawn: Mapping[str, Curve], last: float, border: float | None
) -> None:
    values = [v for curve in drawn.values() for _, v in curve]
    margin = 0.06 * (max(values) - min(values)) or 0.05 * abs(values[0]) or 0.5
    low, high = min(values) - margin, max(values) + margin

    def place(step: float, value: float) -> tuple[int, int]:
        return round(LEFT + step / last * (WIDTH - LEFT - RIGHT)), round(
            HEIGHT - UNDER - (value - low) / (high - low) * (HEIGHT - ABOVE - UNDER)
        )

    for t in ticks(0.0, last):
        x, _ = place(t, low)
        cv2.line(panel, (x, ABOVE), (x, HEIGHT - UNDER), GRID, 1)
        _write(cv2, panel, f"{t:g}", (x - 10, HEIGHT - UNDER + 20))
    for t in ticks(low, high):
        _, y = place(0.0, t)
        cv2.line(panel, (LEFT, y), (WIDTH - RIGHT, y), GRID, 1)
        _write(cv2, panel, f"{t:.6g}", (14, y + 5))
    if border is not None:
        x, _ = place(border, low)
        cv2.line(panel, (x, ABOVE), (x, HEIGHT - UNDER), PHASE, 2)
    cv2.rectangle(panel, (LEFT, ABOVE), (WIDTH - RIGHT, HEIGHT - UNDER), INK, 1)
    _write(cv2, panel, f"{title}, by step", (LEFT, 22))
    for n, (name, curve) in enumerate(drawn.items()):
        color = COLORS[n % len(COLORS)]
        points = [place(*p) for p in curve]
        cv2.polylines(panel, [np.array(points, np.int32).reshape(-1, 1, 2)], False, color, 2, cv2.LINE_AA)
        if len(points) < SMOOTH:
            for p in points:
                cv2.circle(panel, p, 3, color, -1, cv2.LINE_AA)
        _write(cv2, panel, name, (LEFT + 130 * (n % 4), ABOVE - 10), color)


def _write(cv2: Any, page: np.ndarray, text: str, at: tuple[int, int], color: tuple[int, int, int] = INK) -> None:
    cv2.putText(page, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, color, 1, cv2.LINE_AA)
