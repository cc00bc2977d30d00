"""The picture of the refinement benchmark: box PSNR against seconds a frame, on a logarithmic axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posegaussian.dags.charts.style import BLUE, GREEN, GREY, RED, chart, name_points, seconds_axis

METHODS = {
    "floor": (GREEN, "without network and refinement"),
    "refinement": (RED, "refinement, by steps"),
    "3dgs": (BLUE, "3DGS from points on the hull, by seconds"),
    "3dgs, unclipped": (GREY, "the same, not clipped to the masks"),
}
"""{method: (colour, words)} of each curve."""


def draw(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Write a PNG: a curve a method; rows with `method`, `level`, `seconds` and `box psnr`."""
    with chart(file, 8.5, 4.8) as figure:
        axes = figure.subplots()
        named = [r for r in rows if r["method"] in METHODS]
        for method, (color, words) in METHODS.items():
            curve = [(float(r["seconds"]), float(r["box psnr"])) for r in named if r["method"] == method]
            if curve:
                axes.plot(*zip(*curve, strict=True), "o-", color=color, label=words)
        axes.set(title="What optimisation gains on held-out views; 8 cameras, 512 px", ylabel="box PSNR, dB")
        seconds_axis(axes, "CPU seconds a frame", [float(r["seconds"]) for r in named])
        axes.margins(0.06, 0.09)
        axes.legend(loc="lower right")
        points = [(float(r["seconds"]), float(r["box psnr"])) for r in named]
        name_points(axes, points, [str(r["level"]) for r in named], [METHODS[r["method"]][0] for r in named])
