"""The one style of every chart: colours, sizes, names of points, and files that are equal where the numbers are.

matplotlib draws, never through pyplot, so a chart leaves nothing behind in the process. Loading it takes most of a
second: import this module where a chart is drawn, not before.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter
from matplotlib.transforms import Affine2D, ScaledTranslation, offset_copy

from posegaussian.storage.files.write import write_atomically

INK, FAINT, GRID = "#182028", "#62686e", "#e2e4e6"
"""Text and axes, what is said beside, lines of the grid."""
RED, BLUE, GREEN, PURPLE, GREY = "#d73c2d", "#286e96", "#2f8f4e", "#8a4fa3", "#8ca0b0"
"""Of curves and points; red is what the reader is to look at, grey what stands behind it."""
CURVES = (RED, BLUE, GREEN, PURPLE)
"""Of curves that share a panel, in order."""
LOGARITHMIC = 6.0
"""Ratio of the largest to the smallest value above which an axis of seconds is logarithmic."""
STYLE: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Verdana"],  # the first comes with matplotlib; for readers of an SVG one as wide
    "font.size": 9.5,
    "text.parse_math": False,  # names of sequences and cameras may hold a dollar
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "lines.linewidth": 1.8,
    "lines.markersize": 6,
    "legend.frameon": False,
    "figure.constrained_layout.w_pad": 0.12,
    "figure.constrained_layout.h_pad": 0.1,
    "savefig.dpi": 150,
    "figure.dpi": 150,
    "svg.fonttype": "none",  # words stay words: they can be searched and read aloud
    "svg.hashsalt": "posegaussian",  # else every file has identifiers of its own
}
_NO_METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": dict.fromkeys(("Date", "Creator", "Format", "Type")),
}
"""By ending; a date or a version would make files differ where the numbers are equal."""

_DIRECTIONS = [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)]


@contextmanager
def chart(file: Path, width: float, height: float) -> Iterator[Figure]:
    """A figure of `width` by `height` inches, which the block fills; then `file`, a `.png` or `.svg`, is written.

    matplotlib's settings are the style's within the block, whatever the user's own are, and as they were after it.
    Equal charts give equal bytes. Raises NotWritten.
    """
    out = BytesIO()
    with style.context(["default", STYLE]):
        figure = Figure((width, height), layout="constrained")
        yield figure
        figure.savefig(out, format=file.suffix[1:].lower(), metadata=_NO_METADATA[file.suffix.lower()])
    write_atomically(file, out.getvalue())


def heading(figure: Any, text: str, size: float = 12, **properties: Any) -> None:
    """A title over a figure or a part of one, at its left, in lines that fit its width."""
    inches = figure.bbox.width / figure.dpi
    wrapped = textwrap.fill(text, max(20, int(inches * 72 / (0.7 * size))))
    figure.suptitle(wrapped, x=0.01, ha="left", size=size, **properties)


def seconds_axis(axes: Axes, words: str, values: Sequence[float]) -> None:
    """Name the lower axis; it is logarithmic, and says so, where the values span more than LOGARITHMIC."""
    logarithmic = min(values) > 0 and max(values) > LOGARITHMIC * min(values)
    if logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    else:
        axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.set_xlabel(words + (" (logarithmic)" if logarithmic else ""))


def name_points(
    axes: Axes,
    points: Sequence[tuple[float, float]],
    names: Sequence[str],
    colors: Sequence[str],
    **properties: Any,
) -> None:
    """Write a name beside each point, where it hides the least of points, curves and other names; a thin line leads to
    one that is not next to its point.

    To be called last: curves that are drawn and limits that are set later are not seen. `properties` are those of the
    text.
    """
    figure: Any = axes.get_figure(root=True)
    figure.draw_without_rendering()
    px = figure.dpi / 72
    at = axes.transData.transform(np.asarray(points, np.float64))
    taken = [*_squares(at, 5 * px), *(b for line in axes.lines for b in _along(axes, line.get_xydata(), px))]
    frame = np.asarray(axes.bbox.extents)
    for (x, y), point, name, color in zip(at, points, names, colors, strict=True):
        label = axes.text(*point, name, color=color, ha="center", va="center", **properties)
        label.set_in_layout(False)
        box = label.get_window_extent()
        reach = np.array([box.width / 2 + px, box.height / 2]) + 5 * px
        offsets = [np.array(d) * reach * (0.8 if all(d) else 1) * far for far in (1, 1.7, 2.4) for d in _DIRECTIONS]
        boxes = [_square(x + dx, y + dy, box.width / 2 + px, box.height / 2) for dx, dy in offsets]
        hidden = _hidden(np.array(boxes), np.array(taken), frame)
        best = int(np.argmin(hidden + 0.3 * px * np.arange(len(boxes))))
        dx, dy = (float(d) / px for d in offsets[best])
        label.set_transform(offset_copy(axes.transData, figure, x=dx, y=dy, units="points"))
        taken.append(boxes[best])
        if best >= len(_DIRECTIONS):
            left, low, right, high = boxes[best]
            nearest = (float(np.clip(x, left, right) - x) / px, float(np.clip(y, low, high) - y) / px)
            _lead(axes, point, nearest)


def _lead(axes: Axes, point: tuple[float, float], end: tuple[float, float]) -> None:
    """A thin line from a point to what is so many pt right of and above it; the figure's, for it is no curve."""
    figure: Any = axes.get_figure(root=True)
    data: Any = axes.transData
    from_point = Affine2D().scale(1 / 72) + figure.dpi_scale_trans + ScaledTranslation(*point, data)
    line = Line2D(*zip((0, 0), end, strict=True), color=FAINT, linewidth=0.5, transform=from_point)
    line.set_in_layout(False)
    figure.add_artist(line)


def _square(x: float, y: float, across: float, up: float) -> np.ndarray:
    return np.array([x - across, y - up, x + across, y + up])


def _squares(at: np.ndarray, half: float) -> list[np.ndarray]:
    return [_square(x, y, half, half) for x, y in at]


def _along(axes: Axes, line: Any, px: float) -> list[np.ndarray]:
    """Small squares on a curve, one every few px."""
    at = axes.transData.transform(np.asarray(line, np.float64))
    out: list[np.ndarray] = []
    for a, b in pairwise(at):
        length = float(np.hypot(*(b - a)))
        if np.isfinite(length):
            out += _squares(np.linspace(a, b, 2 + int(length / (4 * px))), 1.5 * px)
    return out


def _hidden(boxes: np.ndarray, taken: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """[n] px^2 of other things [m, 4] under each box [n, 4], and thrice what of it lies outside the frame [4]."""
    outside = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1) - _shared(boxes, frame)
    return np.asarray(_shared(boxes[:, None], taken).sum(axis=1) + 3 * outside)


def _shared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Areas that boxes [..., 4] have in common."""
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    return np.asarray(np.maximum(sides, 0).prod(axis=-1))
