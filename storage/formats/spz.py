"""Splats as Niantic's SPZ, version 2, which every reader of the format knows: a quarter to a sixth of a PLY.

One gzip stream: a header of 16 bytes, then positions (24-bit fixed point), alphas, colours, scales and rotations of all
Gaussians. Axes and units stay those of the splats. Format: https://github.com/nianticlabs/spz, src/cc/load-spz.cc. Own
code in place of gsply, whose compressed bytes depend on which other libraries are installed; tests read with gsply.
"""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np

from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.splats import Splats

MAGIC, VERSION = 0x5053474E, 2
FRACTION = 12
"""Bits of a position behind the point: 0.24 mm of a metre."""
FARTHEST = 2.0 ** (23 - FRACTION)
"""Units from the origin that 24 bits hold."""
COLOR = 0.15 * 255
"""Of a byte a unit of the constant harmonic: colours beyond sRGB have room, too."""


def write_spz(path: str | Path, splats: Splats) -> None:
    """Write Gaussians of degree 0. Equal splats give equal bytes.

    Positions are rounded to 2^-12 units, colours to 1/136 of sRGB's range, alphas to 1/255, logarithms of scales to
    1/16 (within -10 to 5.9), quaternions' components to 1/127.5. Raises UserError for a Gaussian that is not finite
    or lies beyond 2048 units, ValueError for another degree, and NotWritten.
    """
    if splats.degree != 0:
        raise ValueError(f"splats of degree {splats.degree} are not written as SPZ, only of degree 0")
    if not (np.abs(splats.mean) < FARTHEST).all():
        far = int(np.argmin((np.abs(splats.mean) < FARTHEST).all(axis=1)))
        raise UserError(
            f"{path}: Gaussian {far} lies at {splats.mean[far].tolist()}, an SPZ holds up to {FARTHEST:g} units from"
            " the origin; write a PLY"
        )
    fixed = np.rint(splats.mean.astype(np.float64) * 2**FRACTION).astype("<i4")
    positions = np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[..., :3]
    turn = splats.quaternion.astype(np.float64)
    turn = turn / np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1e-300)
    turn = np.where(turn[:, :1] < 0, -turn, turn)  # w is taken as positive by readers
    parts = (
        positions,
        _bytes(255 / (1 + np.exp(-splats.opacity_logit.astype(np.float64)))),
        _bytes(splats.harmonics[:, 0] * COLOR + 127.5),
        _bytes((splats.log_scale + 10) * 16),
        _bytes(turn[:, 1:] * 127.5 + 127.5),
    )
    head = struct.pack("<IIIBBBB", MAGIC, VERSION, len(splats), 0, FRACTION, 0, 0)
    write_atomically(Path(path), gzip.compress(head + b"".join(p.tobytes() for p in parts), 6, mtime=0))


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(np.nan_to_num(values), 0, 255)).astype(np.uint8)
