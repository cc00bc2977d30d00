"""HDF5 files as plain data: arrays of numbers and encoded pictures, by their paths in the file.

A file can name other files, to be opened in its place (external and soft links, external storage, virtual data sets);
none is followed. What an array takes is looked at before it is read: a few bytes can describe any shape. Python's h5py
is an extra of this package.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from posegaussian.storage.model.documents import MEGABYTE, MOST_DIGITS, reader_of, regular
from posegaussian.storage.model.errors import SourceError

LARGEST_ARRAY = 256 * MEGABYTE
"""Bytes of an array, or of the part of one, that is read at once."""
LARGEST_CHUNK = 256 * MEGABYTE
"""Bytes of a chunk, which is unpacked whole."""
MOST_ENTRIES = 1_000_000
"""Entries of a group."""


def _h5py() -> ModuleType:
    try:
        import h5py
    except ImportError as e:
        raise SourceError(
            "reading HDF5 files (.smc, .hdf5) needs the library h5py; install it with pip install 'posegaussian[hdf5]'"
        ) from e
    return h5py


class Hdf5File:
    """One file, opened when it is first asked; `what` is for sentences.

    Every method raises SourceError, naming the file and the path in it, for what is not there, is no plain data, or
    cannot be read.
    """

    def __init__(self, path: str | Path, what: str) -> None:
        regular(path, what)
        self.path = Path(path)
        self._what = what

    def entries(self, place: str) -> list[str]:
        """Names in a group, whole numbers in their order, then the others; empty where there is no such group."""
        found = self._find(place)
        if found is None or not isinstance(found, _h5py().Group):
            return []
        with reader_of(self.path, self._what):
            if len(found) > MOST_ENTRIES:
                raise ValueError(f"{place} has {len(found)} entries")
            names = list(found)
        return sorted(names, key=lambda n: (0, int(n), n) if _is_number(n) else (1, 0, n))

    def numbered(self, place: str) -> dict[int, str]:
        """{number: path} of a group's entries that are called by whole numbers, ascending."""
        return {int(n): f"{place}/{n}" for n in self.entries(place) if _is_number(n)}

    def has(self, place: str) -> bool:
        """Whether something is there."""
        return self._find(place) is not None

    def shape(self, place: str) -> tuple[int, ...]:
        """Shape of an array of numbers."""
        return tuple(self._array(place).shape)

    def numbers(self, place: str, shapes: Sequence[tuple[int, ...]] = ()) -> np.ndarray:
        """An array as float64, of one of the shapes where any are given; -1 stands for any length."""
        array = self._array(place)
        if shapes and not any(_fits(array.shape, s) for s in shapes):
            raise SourceError(
                f"{self.path}: {place} has the shape {array.shape}; {' or '.join(map(str, shapes))} is expected"
            )
        return self._read(array, place, ()).astype(np.float64)

    def row(self, place: str, index: int) -> np.ndarray:
        """Entry `index` of the first axis of an array of numbers, as it is kept."""
        array = self._array(place)
        if array.ndim == 0 or not 0 <= index < array.shape[0]:
            raise SourceError(f"{self.path}: {place} of shape {array.shape} has no entry {index}")
        return self._read(array, place, index)

    def encoded(self, place: str) -> bytes:
        """The bytes of an encoded picture, an array [n] of uint8."""
        array = self._array(place)
        if array.ndim != 1 or array.dtype != np.uint8:
            raise SourceError(
                f"{self.path}: {place} is {array.dtype} of shape {array.shape}; the bytes of a JPEG or PNG are expected"
            )
        return self._read(array, place, ()).tobytes()

    @cached_property
    def _file(self) -> Any:
        h5py = _h5py()
        with reader_of(self.path, self._what):
            return h5py.File(self.path, "r", locking=False)

    def _find(self, place: str) -> Any:
        """What lies at a path by links within the file, or None."""
        h5py = _h5py()
        found = self._file
        for part in place.split("/"):
            with reader_of(self.path, self._what):
                link = found.get(part, getlink=True) if isinstance(found, h5py.Group) else None
                if link is None:
                    return None
                if not isinstance(link, h5py.HardLink):
                    raise SourceError(
                        f"{self.path}: {place} is a link to another place; links are not followed, so put in its place"
                        " what it links to"
                    )
                found = found[part]
        return found

    def _array(self, place: str) -> Any:
        found = self._find(place)
        if found is None:
            raise SourceError(f"{self.path} has no {place}; is it whole, and of this data set?")
        with reader_of(self.path, self._what):
            if not isinstance(found, _h5py().Dataset):
                raise ValueError(f"{place} is a group, an array is expected")
            if found.dtype.kind not in "fiub":
                raise ValueError(f"{place} holds {found.dtype.kind!r}, numbers are expected")
            if found.is_virtual or found.external:
                raise ValueError(f"{place} has its numbers in other files, which are not opened")
            if found.shape is None:
                raise ValueError(f"{place} is empty")
            chunk = math.prod(found.chunks or ()) * found.dtype.itemsize
            if chunk > LARGEST_CHUNK:
                raise ValueError(f"{place} has chunks of {chunk} bytes, at most {LARGEST_CHUNK} are read")
        return found

    def _read(self, array: Any, place: str, at: Any) -> np.ndarray:
        size = math.prod(array.shape if at == () else array.shape[1:]) * array.dtype.itemsize
        if size > LARGEST_ARRAY:
            raise SourceError(f"{self.path}: {place} takes {size} bytes, at most {LARGEST_ARRAY} are read at once")
        with reader_of(self.path, self._what):
            return np.asarray(array[at])


def _is_number(name: str) -> bool:
    return name.isascii() and name.isdigit() and len(name) <= MOST_DIGITS


def _fits(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    return len(shape) == len(wanted) and all(w in (-1, n) for n, w in zip(shape, wanted, strict=True))
