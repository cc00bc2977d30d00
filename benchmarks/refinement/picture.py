"""The picture of the refinement benchmark: box PSNR against seconds a frame, on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posegaussian.dags.tradeoff.figure import log_ticks, ticks

WIDTH, HEIGHT = 900, 520
LEFT, RIGHT, UNDER, ABOVE = 80, 30, 70, 50
"""Borders of the plot, px."""
INK, GRID = (40, 32, 24), (226, 222, 218)
COLORS = {"refinement": (45, 60, 215), "plain": (150, 110, 40), "plain, unclipped": (190, 170, 140)}
"""Of each curve, as (blue, green, red)."""


def draw(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Write a PNG: a curve a method; rows with `method`, `level`, `seconds` and `box psnr`."""
    page = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    x, y = [[float(r[k]) for r in rows] for k in ("seconds", "box psnr")]
    low, high = min(x) / 1.3, max(x) * 1.3
    floor, ceiling = min(y) - 0.3, max(y) + 0.4

    def place(seconds: float, decibels: float) -> tuple[int, int]:
        across, up = math.log(seconds / low) / math.log(high / low), (decibels - floor) / (ceiling - floor)
        return round(LEFT + across * (WIDTH - LEFT - RIGHT)), round(HEIGHT - UNDER - up * (HEIGHT - ABOVE - UNDER))

    for t in log_ticks(low, high):
        at, _ = place(t, floor)
        cv2.line(page, (at, ABOVE), (at, HEIGHT - UNDER), GRID, 1)
        _write(page, f"{t:g}", (at - 8, HEIGHT - UNDER + 22))
    for t in ticks(floor, ceiling):
        _, at = place(low, t)
        cv2.line(page, (LEFT, at), (WIDTH - RIGHT, at), GRID, 1)
        _write(page, f"{t:.1f}", (LEFT - 50, at + 5))
    cv2.rectangle(page, (LEFT, ABOVE), (WIDTH - RIGHT, HEIGHT - UNDER), INK, 1)
    _write(
        page,
        "Box PSNR of held-out views, dB, against CPU seconds a frame (logarithmic); 8 cameras, 512 px",
        (LEFT, ABOVE - 18),
    )
    for name, color in COLORS.items():
        curve = [
            (place(float(r["seconds"]), float(r["box psnr"])), str(r["level"])) for r in rows if r["method"] == name
        ]
        cv2.polylines(page, [np.array([p for p, _ in curve], np.int32).reshape(-1, 1, 2)], False, color, 2, cv2.LINE_AA)
        for point, label in curve:
            cv2.circle(page, point, 6, color, -1, cv2.LINE_AA)
            _write(page, label, (point[0] - 10, point[1] - 12), color)
    for i, (name, color) in enumerate(COLORS.items()):
        text = (
            "refinement, steps"
            if name == "refinement"
            else "plain start (hull points), seconds" + name.removeprefix("plain")
        )
        _write(page, text, (LEFT + 10 + 270 * i, HEIGHT - 18), color)
    cv2.imwrite(str(file), page)


def _write(page: np.ndarray, text: str, at: tuple[int, int], color: tuple[int, int, int] = INK) -> None:
    cv2.putText(page, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.46, color, 1, cv2.LINE_AA)
