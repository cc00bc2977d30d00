"""Gaussians that are the pixels of a source view, as few bytes: what `decode.js` reads back.

A Gaussian of the pipeline is a pixel of a camera: where it lies follows from its depth, and its neighbours in the
picture are its neighbours in space. So every attribute is kept as a picture, quantised, and of every pixel the
difference to what its left, upper and upper left neighbours foretell. How finely, was chosen by what is seen: places
decide, everything else may be coarse.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

DEPTH_STEPS = 16
"""Steps of depth in the width of a pixel. The demo at 256 px, beside unquantised Gaussians: 46.2 dB with 16, 44.2 with
8, 42 with 4; each doubling costs 0.1 byte a Gaussian."""
MOST_DEPTH = 2**16 - 1
"""Largest number of depth steps."""
NORMAL_STEPS = 63
"""Steps of each of the two numbers of an octahedral normal, two degrees: 255 cost 0.5 bytes and bring 0.4 dB."""
SCALE_STEPS = 6
"""Steps of a scale in an octave, 6 % at most: 12 cost 0.3 bytes and bring 0.5 dB."""
SCALE_ZERO = 128
"""Number of a scale that is as long as a pixel is wide."""
OPACITY_STEPS = 31
"""Steps of an opacity: 255 cost 0.6 bytes and bring nothing."""
TURN_STEPS = 256
"""Steps of a full turn about the normal."""
SHIFT_STEPS, SHIFT_ZERO = 8, 128
"""Steps of a shift in a pixel, and the number of none: half a step is a sixteenth of a pixel."""
HEAD = struct.Struct("<4HffI")
"""Of a view: left, top, width, height of the crop in px; depth of step 0 in metres; a step, in the natural logarithm
of depth; number of Gaussians."""
PLANES = (
    "depth_low", "depth_high", "normal_x", "normal_y", "scale_0", "scale_1", "scale_2", "green", "red", "blue",
    "face_on", "grazing", "turn", "right", "down",
)  # fmt: skip
"""Pictures of a view, in the order of the file, a byte a Gaussian each; `turn` only where there is a twist, `right` and
`down` where there is a shift."""


@dataclass(frozen=True, eq=False)
class ViewMaps:
    """One frame of one source view."""

    color: np.ndarray
    """[h, w, 3] uint8 sRGB."""
    depth: np.ndarray
    """[h, w] metres along the optical axis; 0, or not finite, where there is no Gaussian."""
    scale: np.ndarray
    """[3, h, w] standard deviations in metres along (tangent, tangent, normal)."""
    normal: np.ndarray
    """[3, h, w] normals of any length in camera axes; none means (0, 0, -1)."""
    opacity: np.ndarray
    """[2, h, w] face-on and at grazing angle, 0..1."""
    twist: np.ndarray | None
    """[2, h, w] cosine and sine of the turn about the normal; None: no turn."""
    focal: float
    """Mean focal length, px: a pixel is depth / focal wide."""
    shift: np.ndarray | None = None
    """[2, h, w] px right of and below the pixel's centre; None: none."""


@dataclass(frozen=True, eq=False)
class CodedView:
    """A view as bytes, ready to be put beside the others of its frame."""

    head: bytes
    """`HEAD`."""
    present: bytes
    """A bit a pixel of the crop, row by row, highest bit first: whether it is a Gaussian."""
    planes: tuple[bytes, ...]
    """`PLANES`: differences of the Gaussians' numbers to what was foretold, modulo 256, row by row."""

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return int(HEAD.unpack(self.head)[-1])


def coded(maps: ViewMaps) -> CodedView:
    """A view's Gaussians: pixels with a finite depth in front of the camera, some opacity, and nothing else that is
    not finite. Equal maps give equal bytes."""
    there = present(maps)
    rows, columns = np.flatnonzero(there.any(axis=1)), np.flatnonzero(there.any(axis=0))
    if not len(rows):
        return CodedView(HEAD.pack(0, 0, 0, 0, 1.0, 1.0, 0), b"", tuple(b"" for _ in _names(maps)))
    top, left = int(rows[0]), int(columns[0])
    crop = np.s_[top : rows[-1] + 1, left : columns[-1] + 1]
    there = there[crop]
    depth = np.where(there, maps.depth[crop], 1.0).astype(np.float64)
    nearest, farthest = (float(np.float32(f(depth[there]))) for f in (np.min, np.max))
    step = float(np.float32(max(1 / (DEPTH_STEPS * maps.focal), np.log(farthest / nearest) / MOST_DEPTH)))
    numbers = np.clip(np.rint(np.log(depth / nearest) / step), 0, MOST_DEPTH).astype(np.int64)
    change = _change(numbers, there)
    folded = np.where(change < 0, -2 * change - 1, 2 * change)  # small numbers of either sign have a high byte of 0
    planes = [folded & 255, folded >> 8 & 255, *(_change(p, there) for p in _shown(maps, crop, depth))]
    height, width = there.shape
    head = HEAD.pack(left, top, width, height, nearest, step, int(there.sum()))
    return CodedView(head, np.packbits(there).tobytes(), tuple((p & 255).astype(np.uint8).tobytes() for p in planes))


def _names(maps: ViewMaps) -> tuple[str, ...]:
    absent = {"turn": maps.twist is None, "right": maps.shift is None, "down": maps.shift is None}
    return tuple(name for name in PLANES if not absent.get(name))


def present(maps: ViewMaps) -> np.ndarray:
    """[h, w] bool: the pixels that are Gaussians."""
    given = [maps.depth[None], maps.scale, maps.normal, maps.opacity, maps.twist, maps.shift]
    sane = np.isfinite(np.concatenate([a for a in given if a is not None])).all(axis=0)
    return sane & (maps.depth > 0) & (maps.opacity[0] > 0)


def _shown(maps: ViewMaps, crop: tuple[slice, slice], depth: np.ndarray) -> list[np.ndarray]:
    """The quantised pictures behind depth, [h, w] int64 each; `depth` [h, w] metres of the crop."""
    scale, opacity = (_finite(a[:, *crop]) for a in (maps.scale, maps.opacity))
    wide = np.maximum(scale, 1e-12) * maps.focal / depth
    red, green, blue = np.moveaxis(maps.color[crop].astype(np.int64), -1, 0)
    planes = [
        *octahedral(_finite(maps.normal[:, *crop])),
        *np.clip(np.rint(np.log2(wide) * SCALE_STEPS) + SCALE_ZERO, 0, 255).astype(np.int64),
        green,
        (red - green + 128) & 255,  # grey is in the middle, so that next to nothing wraps around
        (blue - green + 128) & 255,
        *np.rint(np.clip(opacity, 0, 1) * OPACITY_STEPS).astype(np.int64),
    ]
    if maps.twist is not None:
        cosine, sine = _finite(maps.twist[:, *crop])
        planes.append(np.rint(np.arctan2(sine, cosine) / (2 * np.pi) * TURN_STEPS).astype(np.int64) & 255)
    if maps.shift is not None:
        steps = np.rint(_finite(maps.shift[:, *crop]) * SHIFT_STEPS) + SHIFT_ZERO
        planes.extend(np.clip(steps, 0, 255).astype(np.int64))
    return planes


def _finite(values: np.ndarray) -> np.ndarray:
    """As float64; 0 where there is no number, which only pixels without a Gaussian have."""
    return np.nan_to_num(values.astype(np.float64), posinf=0, neginf=0)


def octahedral(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two numbers [...] int64 of 0..`NORMAL_STEPS` of vectors [3, ...]: the octahedron unfolded about (0, 0, -1),
    towards the camera, whose half that looks away lies in the corners (Meyer et al., "On floating-point normal
    vectors", 2010)."""
    x, y, z = normal
    size = np.abs(normal).sum(axis=0)
    x, y = (np.where(size > 0, a / np.where(size > 0, size, 1), 0.0) for a in (x, y))
    away = z > 0
    folded = [(1 - np.abs(b)) * np.where(a < 0, -1.0, 1.0) for a, b in ((x, y), (y, x))]
    u, v = (np.where(away, f, a) for f, a in zip(folded, (x, y), strict=True))
    first, second = (np.rint((a + 1) / 2 * NORMAL_STEPS).astype(np.int64) for a in (u, v))
    return first, second


def _change(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """[N] differences of the Gaussians' numbers [h, w] to what their neighbours foretell.

    A pixel without a Gaussian repeats the number to its left, and pixels beside the picture are 0. Foretold is the
    median of left, upper, and left + upper - upper left, which finds edges (Weinberger et al., "LOCO-I", 2000).
    """
    last = np.maximum.accumulate(np.where(present, np.arange(present.shape[1]), 0), axis=1)
    filled = np.take_along_axis(np.where(present, values, 0), last, axis=1)
    around = np.pad(filled, ((1, 0), (1, 0)))
    left, upper, corner = around[1:, :-1], around[:-1, 1:], around[:-1, :-1]
    low, high = np.minimum(left, upper), np.maximum(left, upper)
    foretold = np.clip(left + upper - corner, low, high)
    return (filled - foretold)[present]
