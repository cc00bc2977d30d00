"""Masks as data: where a pixel belongs to the subject."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

FOREGROUND = 127
"""A mask value above this is foreground: at least half of the pixel is covered."""


def foreground(mask: np.ndarray) -> np.ndarray:
    """[...] uint8 mask, 0..255 -> bool."""
    return mask > FOREGROUND


def rim_share(inside: np.ndarray) -> float:
    """Share of the picture's outermost pixels that are foreground, [h, w] bool."""
    rows, columns = inside[[0, -1]], inside[1:-1, [0, -1]]
    return float((rows.sum() + columns.sum()) / (rows.size + columns.size))


ROUND = 0.75
"""Share of a picture's rim beyond which a mask goes around the picture, and not a subject through it: it marks the
background, or nothing is cut out. A person filmed so near that only the head is whole has half of it."""

MOST = 0.5
"""Share of a picture beyond which a mask holds most of it."""
ALL_AROUND = 0.9
"""Share of the rim beyond which a mask that holds most of the picture is the wrong way round where its camera's others
hold less: a person so near would leave next to nothing of the picture."""
NEARLY_EMPTY = 0.002
"""Share of the picture below which a mask holds nobody."""
_WIDEST = 3
"""Px that a line along a picture's edge is wide at most."""
_LINE, _BESIDE = 0.9, 0.5
"""Share of an edge that a line makes white at least, and of the pixels beside it that may be the subject's: one that
the edge cuts off is as wide there as at the edge."""


def line_widths(inside: np.ndarray) -> tuple[int, ...]:
    """[4] px of a line that was drawn along the edges of a mask [h, w] bool, such as a frame around a region: along its
    top, right, bottom and left; 0 of one without."""
    found = []
    for quarter in range(4):
        edge = np.rot90(inside, quarter)[: _WIDEST + 2]
        share = edge.mean(axis=1)
        width = int(np.argmin(share >= _LINE))
        drawn = width + 1 < len(share) and share[width] <= _BESIDE
        found.append(width if drawn else 0)
    return tuple(found)


def without_line(mask: np.ndarray, widths: Sequence[int]) -> np.ndarray:
    """A mask [h, w] whose edges show what lies inwards of a line of these widths, `line_widths`, and of the pixel
    beside it, which compression or scaling has made grey: a subject that the edge cuts off stays so."""
    out = mask.copy()
    for quarter, width in enumerate(widths):
        edge = np.rot90(out, quarter)
        if width:
            edge[: width + 1] = edge[width + 1]
    return out


def marks_background(inside: np.ndarray) -> bool:
    """Whether a mask [h, w] bool holds what is around a subject: nearly all of the rim, most of the picture, and not
    all of it."""
    return bool(rim_share(inside) > ALL_AROUND and NEARLY_EMPTY < 1 - inside.mean() < 1 - MOST)
