"""Depth maps that a user gives to reconstruct from, one folder a camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.common import file_stream, gap_notes, numbered, size_of
from posegaussian.storage.model.capture import Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers import images

SUFFIXES = (".exr", ".png", ".tif", ".tiff")
"""File endings of depth maps."""
PLAUSIBLE = (0.2, 200.0)
"""Metres between which the median depth of a picture with a person lies; beyond, the unit is another."""
LOOKED_AT = 3
"""Maps of a camera whose median is taken."""


def depth_map_streams(
    names: Sequence[str], folders: Sequence[Path], pictures: Sequence[Stream], scale: float | None, unit: float = 1.0
) -> tuple[tuple[Stream | None, ...], list[str]]:
    """(depth maps of every view or None, notes), one folder a camera; none at all where no folder has any.

    `scale` is metres per unit of the files; None: floats are in units of `unit` metres, and integers are refused. Maps
    may be smaller or larger than their pictures, but show the same field. Raises SourceError for maps of another shape,
    of a unit that is not known, or whose median is no distance of a person.
    """
    return depth_file_streams(names, [numbered(f, SUFFIXES) for f in folders], pictures, scale, unit=unit)


def depth_file_streams(
    names: Sequence[str],
    found: Sequence[Mapping[int, Path]],
    pictures: Sequence[Stream],
    scale: float | None,
    inverse: bool = False,
    unit: float = 1.0,
) -> tuple[tuple[Stream | None, ...], list[str]]:
    """`depth_map_streams` of files {source frame number: map} a camera; with `inverse`, scale is 1/metres a unit."""
    streams: list[Stream | None] = []
    notes: list[str] = []
    for name, maps, stream in zip(names, found, pictures, strict=True):
        files = {n: p for n, p in maps.items() if n in set(stream.numbers)}
        if not files:
            streams.append(None)
            continue
        size = size_of("depth map", name, files, stream.size)
        if size != tuple(stream.size):
            notes.append(
                f"camera {name}: depth maps are {size[0]}x{size[1]} px, pictures {stream.size[0]}x{stream.size[1]} px;"
                " both are taken to show the same field"
            )
        if scale is None:
            _refuse_integers(name, files)
        in_metres = unit if scale is None else scale
        _check_unit(name, files, in_metres, inverse)
        inverted = {"inverse": True} if inverse else {}
        streams.append(file_stream("images", files, size, scale=in_metres, **inverted))
    if not any(streams):
        return (), []
    notes += [
        f"camera {n} has no depth maps; depth.method: given needs them of every source view"
        for n, s in zip(names, streams, strict=True)
        if s is None
    ]
    return tuple(streams), notes + gap_notes(names, streams, [np.asarray(s.numbers) for s in pictures], "depth maps")


def _looked_at(files: Mapping[int, Path]) -> list[Path]:
    paths = list(files.values())
    return paths[:: max(1, len(paths) // LOOKED_AT)][:LOOKED_AT]


def _refuse_integers(name: str, files: Mapping[int, Path]) -> None:
    """Raise SourceError for maps of integers, of which nobody says the unit."""
    for p in _looked_at(files):
        if images.holds_integers(p):
            raise SourceError(
                f"camera {name}: depth map {p} holds integers, whose unit is not known; say how many metres one is, for"
                " millimetres --option depth_scale=0.001"
            )


def _check_unit(name: str, files: Mapping[int, Path], scale: float, inverse: bool) -> None:
    """Raise SourceError for maps that cannot be metres."""
    for p in _looked_at(files):
        depth = images.read_depth_map(p, scale, inverse)
        known = depth[depth > 0]
        if known.size and not PLAUSIBLE[0] <= (middle := float(np.median(known))) <= PLAUSIBLE[1]:
            raise SourceError(
                f"camera {name}: the median of depth map {p} is {middle:g} m, which is not between {PLAUSIBLE[0]:g} and"
                f" {PLAUSIBLE[1]:g} m; say how many metres a unit of the files is, for millimetres --option"
                " depth_scale=0.001 (inverse or relative depth must be made metric first)"
            )
