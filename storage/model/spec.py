"""What an array is: dimensions, type, unit, meaning; and how any value is hashed.

Nothing here opens a store. `archive.py` turns an `ArraySpec` into a zarr array; codecs follow from the dtype alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Keep = Literal["always", "until_done", "never"]
Shape = Mapping[str, int]
"""Length of every named dimension of one sequence: frame, view, y, x, joint, source_y, ... (`y/4` follows from `y`)."""

FIXED_DIMS = {
    "rgb": 3,
    "uvs": 3,
    "xyzs": 4,
    "axis": 3,
    "faces": 2,
    "turn": 2,
    "shift": 2,
    "one": 1,
    "coco17": 17,
    "motion": 3,
    "outline": 3,
    "gap": 2,
    "slope": 2,
    "light": 2,
    "octave": 4,
    "fit": 3,
    "kind": 3,
    "told": 2,
    "patch": 192,
    "point": 64,
    "link": 24,
    "two_xy": 4,
    "standing": 7,
    "outcome": 8,
    "heads": 8,
    "region": 4,
    "map_y": 64,
    "map_x": 64,
    "hint_y": 256,
    "hint_x": 256,
    "candidate": 16,
    "person_fact": 8,
    "choice": 3,
    "switch": 2,
    "score": 3,
}
"""Dimensions whose length never depends on the capture: (u, v, score), (x, y, z, score), tangent-tangent-normal, ..."""

BATCH_DIMS = ("frame", "view", "camera")
"""Dimensions a reader wants one at a time: a chunk is one frame of one view."""


LISTED = "gaussian"
"""Dimension of a list, as long as a picture has pixels. The first of a frame and view are used, how many another array
says; the others are 0, and neither stored nor read."""


def dim_length(dim: str, shape: Shape) -> int:
    """Length of one dimension; `"y/4"` means ceil(y / 4).

    Raises KeyError with the known names when the dimension is unknown.
    """
    name, _, divisor = dim.partition("/")
    if name == LISTED:
        return shape["y"] * shape["x"]
    length = FIXED_DIMS.get(name, shape.get(name))
    if length is None:
        raise KeyError(f"unknown dimension {name!r}; known are {sorted({*FIXED_DIMS, *shape})}")
    return -(-length // int(divisor)) if divisor else length


@dataclass(frozen=True)
class ArraySpec:
    """One array of the archive, declared once by the stage that writes it."""

    name: str
    """Path inside the sequence's group; `{path}` stands for the camera path of a rendering task."""
    dims: tuple[str, ...]
    """Named dimensions, batch dimensions (frame, view, camera) first."""
    dtype: str
    """numpy name of the element type."""
    unit: str
    """Unit of the values: m, px, s, "1" for ratios, sRGB for display-referred colour."""
    meaning: str
    """One sentence: what a value says and in which frame of reference."""
    keep: Keep = "always"
    """How long the bytes are kept once every consumer has read them."""
    when: str | None = None
    """Name of the fact without which the array is not written (None: always)."""
    noted: bool = False
    """So small that its values are kept in the receipt too, where a plan finds them without opening a store."""

    def lengths(self, shape: Shape) -> tuple[int, ...]:
        """Length of every dimension for a sequence of the given shape."""
        return tuple(dim_length(d, shape) for d in self.dims)

    @property
    def per_view(self) -> bool:
        """Whether a shard holds one view only."""
        return "view" in self.dims

    @property
    def per_frame(self) -> bool:
        """Whether the array is partitioned along time."""
        return "frame" in self.dims


@dataclass(frozen=True)
class TableSpec:
    """One Parquet table of the archive, one file a partition."""

    name: str
    """Path inside the sequence; `{path}` stands for the camera path."""
    columns: tuple[tuple[str, str], ...]
    """(column, arrow type) in order."""
    meaning: str
    """One sentence: what a row says."""
    when: str | None = None
    """Name of the fact without which the table is not written (None: always)."""


PLAIN = frozenset({str, int, bool, type(None)})
"""Types that are their own canonical form."""

ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False)
"""Writes the canonical form as text."""


def canonical(value: Any) -> Any:
    """A value as plain JSON types with sorted keys, so that equal values hash equally.

    Raises TypeError for what has no canonical form (a set, an open file), rather than hashing its address.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float | np.floating):
        return ["float", float(value).hex()]
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, np.ndarray):
        return ["array", str(value.dtype), list(value.shape), array_digest(value)]
    if isinstance(value, Mapping):
        return {str(k): canonical(value[k]) for k in sorted(value, key=str)}
    if isinstance(value, list | tuple | range):
        return list(value) if PLAIN.issuperset(map(type, value)) else [canonical(v) for v in value]
    raise TypeError(f"no canonical form for {type(value).__name__}: {value!r}")


def digest(value: Any) -> str:
    """BLAKE2b-128 of the canonical form, 32 hex digits."""
    return hashlib.blake2b(ENCODER.encode(canonical(value)).encode(), digest_size=16).hexdigest()


def content_digest(data: np.ndarray, dims: Sequence[str | None]) -> str:
    """`array_digest` of a block over these dimensions; of a list without the zeros after its last entry, however many
    of them were read or written."""
    if LISTED in dims:
        axis = dims.index(LISTED)
        used = np.flatnonzero(data.any(axis=tuple(i for i in range(data.ndim) if i != axis)))
        data = data.take(range(int(used[-1]) + 1 if len(used) else 0), axis)
    return array_digest(data)


def array_digest(array: np.ndarray) -> str:
    """BLAKE2b-128 over dtype, shape and C-order bytes, 32 hex digits. Raises TypeError for arrays of Python objects."""
    if array.dtype.hasobject:
        raise TypeError(f"an array of {array.dtype} has no canonical form: its bytes are addresses")
    h = hashlib.blake2b(f"{array.dtype.str}{array.shape}".encode(), digest_size=16)
    h.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return h.hexdigest()
