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


_SOFT, _SHARP = 0.4, 0.6
"""Mean step across an outline, 1: all of it, of edges that rise over more than two pixels, and of sharp ones: averages
of exact masks have 0.64 to 0.66, the same blurred by 0.7 px 0.38, without soft edges 1."""
_FEWEST_STEPS = 24
"""Rows, and columns, at which a mask must change to tell that it was enlarged in blocks."""
_NATIVE = 0.7
"""Share of the rows or columns of its subject at which a mask changes that has pixels of its own."""


def crispness(mask: np.ndarray) -> float:
    """How sharp a mask [h, w] uint8 is: 1 where edges rise within a pixel, 0 where they rise over several, by the mean
    step from each pixel of the outline to its neighbour beyond; 1 of a mask without any."""
    inside, steps = foreground(mask), list[np.ndarray]()
    for values, subject in ((mask, inside), (mask.T, inside.T)):
        across = subject[1:] != subject[:-1]
        steps.append(np.abs(values[1:][across].astype(np.float64) - values[:-1][across]))
    step = np.concatenate(steps) / 255
    return float(np.clip((step.mean() - _SOFT) / (_SHARP - _SOFT), 0, 1)) if len(step) else 1.0


def without_blocks(mask: np.ndarray) -> np.ndarray:
    """The smaller mask [h', w'] of which a mask [h, w] repeats rows and columns, as programs enlarge a mask to the size
    of its picture; the mask itself where it has pixels of its own."""
    kept = [_of_blocks(values) for values in (mask, mask.T)]
    if kept[0] is None or kept[1] is None:
        return mask
    return mask[np.ix_(kept[0], kept[1])]


def _of_blocks(values: np.ndarray) -> np.ndarray | None:
    """[n] first rows of the blocks that the rows [h, w] of a mask form if it was enlarged from n rows, by at least
    half; None of one that was not.

    Blocks of one size are asked for first. Row i is that of the smaller mask at i, or at i + 0.5, times n / h, rounded
    down: programs differ.
    """
    rows = len(values)
    changed = np.flatnonzero((values[1:] != values[:-1]).any(axis=1)) + 1
    if len(changed) < _FEWEST_STEPS or len(changed) > _NATIVE * (changed[-1] - changed[0] + 1):
        return None
    for count in sorted(range(len(changed), int(rows / 1.5) + 1), key=lambda n: (rows % n != 0, n)):
        for aside in (0.0, 0.5):
            source = np.floor((np.arange(rows) + aside) * count / rows).astype(int)
            starts = np.flatnonzero(np.diff(source, prepend=-1))
            if len(starts) == count and np.isin(changed, starts).all():
                return starts
    return None
