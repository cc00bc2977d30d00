"""HDF5 files as data: what is in the file alone, and no more than is read."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from posegaussian.storage.formats.plain_hdf5 import Hdf5File
from posegaussian.storage.model.errors import SourceError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    with h5py.File(tmp_path / "a.h5", "w") as f:
        f["a/numbers"] = np.arange(6, dtype=np.int16).reshape(2, 3)
        f["a/bytes"] = np.arange(5, dtype=np.uint8)
        f["a/text"] = "x"
        f["a/records"] = np.zeros(3, [("x", "f8")])
        f["a/nothing"] = h5py.Empty("f8")
        f.create_dataset("a/huge", (10**6, 10**6), "f8", chunks=(1, 1000))
        f.create_dataset("a/chunk", (10**6, 10**6), "f8", chunks=(2**13, 2**13))
        for n in (10, 2, 0):
            f[f"frames/{n}"] = n
        f["frames/other"] = 1
        f["soft"], f["external"] = h5py.SoftLink("/a/numbers"), h5py.ExternalLink("/etc/passwd", "x")
    return tmp_path / "a.h5"


def test_what_is_there(path: Path) -> None:
    file = Hdf5File(path, "file")
    np.testing.assert_array_equal(file.numbers("a/numbers", [(2, 3)]), np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(file.row("a/numbers", 1), [3, 4, 5])
    assert file.encoded("a/bytes") == bytes(range(5))
    assert file.entries("frames") == ["0", "2", "10", "other"]
    assert list(file.numbered("frames")) == [0, 2, 10]
    assert (file.entries("none"), file.has("a/none"), file.has("a/numbers/x")) == ([], False, False)
    assert len(file.row("a/huge", 5)) == 10**6  # a row of it is small enough


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (lambda f: f.numbers("a/none"), "has no a/none; is it whole"),
        (lambda f: f.numbers("a"), "a is a group, an array is expected"),
        (lambda f: f.numbers("a/text"), "numbers are expected"),
        (lambda f: f.numbers("a/records"), "holds 'V', numbers are expected"),
        (lambda f: f.numbers("a/nothing"), "a/nothing is empty"),
        (lambda f: f.numbers("a/numbers", [(3, 3)]), r"a/numbers has the shape \(2, 3\); \(3, 3\) is expected"),
        (lambda f: f.numbers("a/huge"), "takes 8000000000000 bytes, at most"),
        (lambda f: f.row("a/chunk", 0), "has chunks of 536870912 bytes, at most"),
        (lambda f: f.row("a/numbers", 2), r"of shape \(2, 3\) has no entry 2"),
        (lambda f: f.encoded("a/numbers"), "is int16 of shape .*; the bytes of a JPEG or PNG are expected"),
        (lambda f: f.numbers("soft"), "soft is a link to another place"),
        (lambda f: f.numbers("external/x"), "external/x is a link to another place"),
    ],
)
def test_everything_else_gets_a_sentence(path: Path, read: Callable[[Any], object], said: str) -> None:
    with pytest.raises(SourceError, match=said):
        read(Hdf5File(path, "file"))


def test_without_the_library_it_is_said_how_it_is_installed(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(SourceError, match=r"needs the library h5py; install it with pip install 'posegau"):
        Hdf5File(path, "file").has("a")
