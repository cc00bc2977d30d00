"""Splat files: standard 3DGS PLY in and out, and the compressed PLY of SuperSplat and PlayCanvas in.

A standard file that was read comes back bit for bit: what a splat does not need (normals, further properties, comments)
is carried along. A compressed file is decoded and may be written as a standard one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.formats.compressed_splat_ply import PACKED, decode
from posegaussian.storage.formats.ply import Ply, read_ply
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.splats import Splats

MEAN, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
DC, SCALE, ROTATION = (
    tuple(f"f_dc_{i}" for i in range(3)),
    tuple(f"scale_{i}" for i in range(3)),
    tuple(f"rot_{i}" for i in range(4)),
)
NEEDED = (*MEAN, *DC, "opacity", *SCALE, *ROTATION)
"""Properties every standard file has."""
RESTS = (0, 9, 24, 45)
"""Numbers of `f_rest_*` of degree 0..3: all of red, then green, then blue."""


@dataclass(frozen=True, eq=False)
class SplatFile:
    """What was read."""

    splats: Splats
    """The scene."""
    carried: Ply | None
    """The standard file itself, for what it holds besides; None for a compressed one."""


def read_splats(path: str | Path) -> SplatFile:
    """Read a standard or a compressed splat file, told apart by their properties.

    Raises SourceError, naming the file and its line, byte or property, for everything else.
    """
    ply = read_ply(path)
    vertex = ply.elements.get("vertex")
    if vertex is None:
        raise SourceError(
            f"{path}: no element 'vertex' among {list(ply.elements)}; a splat file has one row of it for each Gaussian"
        )
    assert vertex.dtype.names is not None or not vertex.dtype.itemsize
    names = vertex.dtype.names or ()
    if set(PACKED) <= set(names):
        return SplatFile(decode(path, ply), None)
    missing = [n for n in NEEDED if n not in names]
    if missing:
        mesh = " (a mesh or a point cloud?)" if "face" in ply.elements or {"red", "green", "blue"} <= set(names) else ""
        raise SourceError(
            f"{path}: element vertex lacks {', '.join(missing)}{mesh}; a 3DGS file has {', '.join(NEEDED)}, a"
            f" compressed one {', '.join(PACKED)}"
        )
    rest = _rest(names)
    if len(rest) not in RESTS or any(n not in names for n in rest):
        raise SourceError(
            f"{path}: element vertex has {len(rest)} properties f_rest_*; {', '.join(map(str, RESTS))} are expected"
            " (degree 0 to 3), numbered from 0"
        )
    for name in (*NEEDED, *rest):
        if vertex.dtype[name].newbyteorder("<") != np.dtype("<f4"):
            raise SourceError(f"{path}: property {name} is {vertex.dtype[name].name}; float is expected")
    return SplatFile(_from_table(vertex, rest), ply)


def _rest(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"f_rest_{i}" for i in range(sum(n.startswith("f_rest_") for n in names)))


def _columns(table: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """[N, len(names)] float32."""
    out = np.empty((len(table), len(names)), np.float32)
    for i, name in enumerate(names):
        out[:, i] = table[name]
    return out


def _from_table(table: np.ndarray, rest: tuple[str, ...]) -> Splats:
    higher = _columns(table, rest).reshape(len(table), 3, len(rest) // 3).transpose(0, 2, 1)
    harmonics = np.concatenate([_columns(table, DC)[:, None, :], higher], axis=1)
    return Splats(
        _columns(table, MEAN),
        _columns(table, SCALE),
        _columns(table, ROTATION),
        _columns(table, ("opacity",))[:, 0],
        harmonics,
    )


def write_splats(path: str | Path, splats: Splats, carried: Ply | None = None) -> None:
    """Write a standard 3DGS PLY: little endian, normals 0, f_rest by colour.

    With `carried`, the file that the splats were read from, header, order and further properties are its own. Raises
    ValueError where that file has another number of Gaussians or another degree.
    """
    ply = _standard(splats) if carried is None else carried
    vertex = ply.elements["vertex"]
    rest = _rest(vertex.dtype.names or ())
    if len(vertex) != len(splats) or len(rest) != RESTS[splats.degree]:
        raise ValueError(
            f"the carried file has {len(vertex)} Gaussians with {len(rest)} f_rest, the splats {len(splats)} with"
            f" {RESTS[splats.degree]}; write without it"
        )
    table = vertex.copy()
    higher = splats.harmonics[:, 1:].transpose(0, 2, 1).reshape(len(splats), len(rest))
    parts = (
        (MEAN, splats.mean),
        (DC, splats.harmonics[:, 0]),
        (rest, higher),
        (("opacity",), splats.opacity_logit[:, None]),
        (SCALE, splats.log_scale),
        (ROTATION, splats.quaternion),
    )
    for names, values in parts:
        for i, name in enumerate(names):
            table[name] = values[:, i]
    write_atomically(Path(path), Ply(ply.header, {**ply.elements, "vertex": table}).tobytes())


def _standard(splats: Splats) -> Ply:
    """An empty file of the layout that Inria's code writes and viewers expect."""
    names = (*MEAN, *NORMAL, *DC, *(f"f_rest_{i}" for i in range(RESTS[splats.degree])), "opacity", *SCALE, *ROTATION)
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(splats)}",
        *(f"property float {n}" for n in names),
        "end_header",
        "",
    ]
    return Ply("\n".join(lines).encode(), {"vertex": np.zeros(len(splats), [(n, "<f4") for n in names])})
