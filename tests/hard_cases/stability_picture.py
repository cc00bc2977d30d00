"""The picture of the catalogue: every case's errors on one logarithmic axis, and what some of them look like."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from posegaussian.storage.readers.images import write_png
from tests.hard_cases.catalogue import Case, Outcome
from tests.hard_cases.thumbnails import thumbnails

WIDTH, ROW, HEAD = 1400, 23, 118
"""Px: the page, one case, everything above the first."""
ZERO, LEFT, RIGHT, BROKEN = 600, 650, 1270, 1300
"""Columns, px: exactly 0; the axis from its least to its largest power of ten; what is no number."""
LEAST, MOST = -17, 11
"""Powers of ten of the axis; beyond, a mark stands on its end."""
TILE, PER_LINE = (166, 139), 4
"""Px of a thumbnail; pairs of them side by side."""
INK, FAINT, GRID = (24, 32, 40), (110, 114, 120), (228, 228, 226)
NAIVE, OURS, BOUND = (208, 62, 48), (30, 128, 84), (60, 60, 60)
"""Colours as (red, green, blue)."""


def draw(file: Path, rows: Sequence[tuple[Case, Outcome]]) -> None:
    """Write the PNG."""
    bottom = HEAD + ROW * len(rows)
    page = np.full((bottom + 30, WIDTH, 3), 255, np.uint8)
    _write(
        page,
        "Worst error of every hard case: the plain formula, and ours, against the bound that is promised",
        (20, 34),
        0.72,
    )
    _legend(page, 62)
    for power in range(LEAST + 1, MOST + 1, 4):
        x = _place(10.0**power)
        cv2.line(page, (x, HEAD - 6), (x, bottom), GRID, 1)
        _write(page, f"1e{power}", (x, HEAD - 12), 0.42, FAINT, centred=True)
    _write(page, "0", (ZERO, HEAD - 12), 0.42, FAINT, centred=True)
    _write(page, "no number", (BROKEN - 8, HEAD - 12), 0.42, FAINT)
    for i, (case, outcome) in enumerate(rows):
        _row(page[HEAD + ROW * i : HEAD + ROW * (i + 1)], case, outcome)
    write_png(file, np.vstack([page, _gallery()]))


def _legend(page: np.ndarray, y: int) -> None:
    x = 20
    for kind, text in ((NAIVE, "naive"), (OURS, "ours"), (None, "bound")):
        if kind is None:
            cv2.line(page, (x + 6, y - 13), (x + 6, y + 3), BOUND, 2)
        else:
            cv2.circle(page, (x + 6, y - 5), 6, kind, -1, cv2.LINE_AA)
        _write(page, text, (x + 20, y), 0.5)
        x += 100
    _write(page, "each in its own unit, in brackets", (x, y), 0.5, FAINT)


def _row(line: np.ndarray, case: Case, outcome: Outcome) -> None:
    """One case: its words, the span between the two errors, the bound, the errors."""
    middle = ROW // 2
    cv2.line(line, (0, ROW - 1), (WIDTH, ROW - 1), (244, 244, 242), 1)
    _write(line, case.name, (20, middle + 5), 0.45)
    _write(line, f"{case.title}  [{case.unit}]", (66, middle + 5), 0.42, FAINT)
    ours, bound = _place(outcome.ours), _place(case.bound)
    number = math.isfinite(outcome.naive)
    naive = _place(outcome.naive) if number else BROKEN
    cv2.line(line, (ours, middle), (naive, middle), (220, 216, 212), 1, cv2.LINE_AA)
    cv2.line(line, (bound, 3), (bound, ROW - 4), BOUND, 2)
    cv2.circle(line, (ours, middle), 5, OURS, -1, cv2.LINE_AA)
    if number:
        cv2.circle(line, (naive, middle), 5, NAIVE, -1, cv2.LINE_AA)
    else:
        cv2.drawMarker(line, (naive, middle), NAIVE, cv2.MARKER_TILTED_CROSS, 10, 2, cv2.LINE_AA)
        _write(
            line,
            "raises" if outcome.raised else "NaN" if math.isnan(outcome.naive) else "infinite",
            (BROKEN + 12, middle + 5),
            0.42,
            NAIVE,
        )


def _place(value: float) -> int:
    """Column of an error."""
    if value == 0:
        return ZERO
    share = (min(max(math.log10(value), LEAST), MOST) - LEAST) / (MOST - LEAST)
    return round(LEFT + share * (RIGHT - LEFT))


def _gallery() -> np.ndarray:
    """Pairs of pictures, naive and ours, with the case's name; pink is no number."""
    found = thumbnails()
    title = np.full((34, WIDTH, 3), 255, np.uint8)
    _write(title, "What some of them look like; pink is no number", (20, 16), 0.6)
    lines = [title]
    for start in range(0, len(found), PER_LINE):
        line = np.full((TILE[1] + 52, WIDTH, 3), 255, np.uint8)
        for i, (text, naive, ours) in enumerate(found[start : start + PER_LINE]):
            x = 20 + i * (2 * TILE[0] + 13)
            _write(line, text, (x, 16), 0.42)
            for j, (picture, label, colour) in enumerate(((naive, "naive", NAIVE), (ours, "ours", OURS))):
                left = x + j * (TILE[0] + 2)
                line[24 : 24 + TILE[1], left : left + TILE[0]] = cv2.resize(
                    picture, TILE, interpolation=cv2.INTER_NEAREST
                )
                _write(line, label, (left, TILE[1] + 40), 0.4, colour)
        lines.append(line)
    return np.vstack(lines)


def _write(
    page: np.ndarray,
    text: str,
    at: tuple[int, int],
    size: float,
    color: tuple[int, int, int] = INK,
    centred: bool = False,
) -> None:
    """One line of text; `at` is its lower left corner, or its lower middle."""
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    cv2.putText(
        page,
        text,
        (at[0] - (width // 2 if centred else 0), at[1]),
        cv2.FONT_HERSHEY_SIMPLEX,
        size,
        color,
        1,
        cv2.LINE_AA,
    )
