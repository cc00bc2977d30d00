"""The picture of a training: loss by step, and every validated measure; measures of one kind share a panel."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from posegaussian.dags.charts.style import CURVES, GREY, chart
from posegaussian.stages.training.config import TrainingConfig

WIDTH, HEIGHT, ACROSS = 5.2, 3.0, 2
"""Of one panel, inches; panels beside each other."""
MOST = 8
"""Panels."""
SMOOTH = 50
"""Points into which the loss is averaged."""
UNITS = {"epe": "EPE, px", "confidence": "confidence, 0 to 1", "psnr": "PSNR, dB"}
"""What stands beside a panel, by the first word of its measures; else that word."""
Curve = list[tuple[float, float]]


def draw(file: Path, rows: Sequence[Mapping[str, Any]], config: TrainingConfig) -> None:
    """Write the PNG from the rows of a log; a grey line parts the phases. Raises NotWritten."""
    panels = list(curves(rows).items())[:MOST]
    last = max(row["step"] for row in rows)
    border = config.depth_steps if 0 < config.depth_steps < last else None
    down = math.ceil(len(panels) / ACROSS)
    with chart(file, WIDTH * ACROSS, HEIGHT * down) as figure:
        places = figure.subplots(down, ACROSS, squeeze=False).flat
        for axes, (title, drawn) in zip(places, panels, strict=False):
            _panel(axes, title, drawn, last, border)
        for axes in places[len(panels) :]:
            axes.set_axis_off()


def curves(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Curve]]:
    """{panel: {name: [(step, value)]}}: the training loss, averaged, and validated measures, by their first word."""
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


def _panel(axes: Axes, title: str, drawn: Mapping[str, Curve], last: float, border: float | None) -> None:
    for n, (name, curve) in enumerate(drawn.items()):
        marker = "o" if len(curve) < SMOOTH else ""
        axes.plot(*zip(*curve, strict=True), marker=marker, markersize=4, color=CURVES[n % len(CURVES)], label=name)
    if border is not None:
        axes.axvline(border, color=GREY, linewidth=1.5, zorder=1)
    kind = re.split("[ ,]", title)[0]
    axes.set(title=title, xlabel="step", ylabel=UNITS.get(kind, kind), xlim=(0, 1.02 * last))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    if len(drawn) > 1:
        axes.legend()
