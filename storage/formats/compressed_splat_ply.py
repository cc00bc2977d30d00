"""The compressed PLY of SuperSplat and PlayCanvas: 16 bytes a Gaussian, in chunks of 256 that share bounds.

Each Gaussian is four unsigned integers: position 11-10-11 bits and log scale 11-10-11 bits between the chunk's bounds;
rotation 2-10-10-10, which component of (w, x, y, z) is largest and the other three, each within +-1/sqrt(2); colour
8-8-8 (between bounds where the chunk has them, else 0..1) and alpha 8. Higher harmonics, where there are any, are bytes
of an element `sh`, +-4. https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/ply/
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posegaussian.storage.formats.ply import Ply
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.splats import SH0, Splats

PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
"""Properties of `vertex`."""
CHUNK = 256
"""Gaussians that share a row of `chunk`."""
OPAQUE = 40.0
"""Logit of alpha 1, and minus that of alpha 0: infinite by the formula, and exactly 1 in float32."""


def decode(path: str | Path, ply: Ply) -> Splats:
    """The Gaussians of a compressed file. `path` is for messages; raises SourceError for what does not fit together."""
    vertex, chunk = ply.elements["vertex"], ply.elements.get("chunk")
    n = len(vertex)
    if chunk is None or len(chunk) != -(-n // CHUNK):
        raise SourceError(
            f"{path}: {n} packed Gaussians need {-(-n // CHUNK)} rows of element chunk, one for {CHUNK}; found"
            f" {0 if chunk is None else len(chunk)}"
        )
    index = np.arange(n) // CHUNK
    position = _between(path, chunk, index, _bits(vertex["packed_position"], (11, 10, 11)), "{}_x {}_y {}_z")
    scale = _between(
        path, chunk, index, _bits(vertex["packed_scale"], (11, 10, 11)), "{}_scale_x {}_scale_y {}_scale_z"
    )
    rgba = _bits(vertex["packed_color"], (8, 8, 8, 8))
    color = (
        _between(path, chunk, index, rgba[:, :3], "{}_r {}_g {}_b")
        if "min_r" in (chunk.dtype.names or ())
        else rgba[:, :3]
    )
    dc = (color - 0.5) / SH0
    harmonics = np.concatenate([dc[:, None, :], _higher(path, ply, n)], axis=1)
    logit = np.full(n, OPAQUE)
    inside = (rgba[:, 3] > 0) & (rgba[:, 3] < 1)
    logit[inside] = -np.log(1 / rgba[inside, 3] - 1)
    logit[rgba[:, 3] <= 0] = -OPAQUE
    return Splats(
        *(a.astype(np.float32) for a in (position, scale, _rotation(vertex["packed_rotation"]), logit, harmonics))
    )


def _bits(packed: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    """[N, len(widths)] float64 in 0..1 of the fields of unsigned integers, highest bits first."""
    fields, shift = [], sum(widths)
    for width in widths:
        shift -= width
        fields.append(((packed >> np.uint32(shift)) & np.uint32(2**width - 1)) / (2**width - 1))
    return np.stack(fields, axis=1)


def _between(path: str | Path, chunk: np.ndarray, index: np.ndarray, share: np.ndarray, names: str) -> np.ndarray:
    """[N, 3] float64: share of the way from the chunk's `min_*` to its `max_*`."""
    low, high = ([s.format(end) for s in names.split()] for end in ("min", "max"))
    missing = [n for n in (*low, *high) if n not in (chunk.dtype.names or ())]
    if missing:
        raise SourceError(
            f"{path}: element chunk lacks {', '.join(missing)}; the bounds of packed values are expected there"
        )
    a, b = (np.stack([chunk[n].astype(np.float64) for n in side], axis=1)[index] for side in (low, high))
    return a * (1 - share) + b * share


def _rotation(packed: np.ndarray) -> np.ndarray:
    """[N, 4] float64 unit quaternions (w, x, y, z)."""
    largest = (packed >> np.uint32(30)).astype(np.int64)
    three = (_bits(packed & np.uint32(2**30 - 1), (10, 10, 10)) - 0.5) * np.sqrt(2)
    rows = np.arange(len(packed))
    out = np.empty((len(packed), 4))
    out[rows, largest] = np.sqrt(np.maximum(0, 1 - (three * three).sum(axis=1)))
    for i in range(3):
        out[rows, i + (i >= largest)] = three[:, i]
    return out


def _higher(path: str | Path, ply: Ply, n: int) -> np.ndarray:
    """[N, K - 1, 3] coefficients of degree 1 and above:
    the ends of a byte are 0 and 1, what lies between is centred."""
    sh = ply.elements.get("sh")
    if sh is None:
        return np.zeros((n, 0, 3))
    names = tuple(f"f_rest_{i}" for i in range(len(sh.dtype.names or ())))
    if (
        len(sh) != n
        or len(names) not in (9, 24, 45)
        or names != sh.dtype.names
        or any(sh.dtype[m] != np.uint8 for m in names)
    ):
        raise SourceError(
            f"{path}: element sh has {len(sh)} rows of {list(sh.dtype.names or ())[:3]}...; {n} rows of 9, 24 or 45"
            " uchar f_rest_* are expected"
        )
    value = np.stack([sh[m] for m in names], axis=1).astype(np.float64)
    share = np.where(value == 0, 0.0, np.where(value == 255, 1.0, (value + 0.5) / 256))
    return ((share - 0.5) * 8).reshape(n, 3, len(names) // 3).transpose(0, 2, 1)
