"""Arrays of numbers come in as numpy writes them; anything else is refused before it is made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.formats.plain_npy import read_numbers
from posegaussian.storage.model.errors import SourceError


@pytest.mark.parametrize("kind", ["<f8", ">f4", "<i2", "u1"])
@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0, 4)])
def test_what_numpy_writes_is_read(tmp_path: Path, kind: str, shape: tuple[int, ...]) -> None:
    array = np.arange(int(np.prod(shape)), dtype=kind).reshape(shape)
    for order in (np.ascontiguousarray(array), np.asfortranarray(array)):
        np.save(tmp_path / "a.npy", order)
        np.testing.assert_array_equal(read_numbers(tmp_path / "a.npy", "array"), np.load(tmp_path / "a.npy"))


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    class Planted:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return Path.touch, (tmp_path / "planted",)  # type: ignore[return-value]

    np.save(tmp_path / "a.npy", np.array({"K": Planted()}, dtype=object), allow_pickle=True)
    with pytest.raises(SourceError, match="numbers are expected; arrays of objects are pickles"):
        read_numbers(tmp_path / "a.npy", "poses")
    assert not (tmp_path / "planted").exists()


def test_sizes_that_the_file_has_not_are_refused_before_anything_is_made(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((10, 17)))
    raw = (tmp_path / "a.npy").read_bytes()
    for new in (raw[:-8], raw + bytes(8), raw.replace(b"(10, 17)", b"(9999999, 99999)"[:8].ljust(8)), raw[:20], b""):
        (tmp_path / "a.npy").write_bytes(new)
        with pytest.raises(SourceError, match=r"a\.npy"):
            read_numbers(tmp_path / "a.npy", "poses")
    huge = raw.replace(b"'shape': (10, 17), }", b"'shape': (1000000000000,)}")
    (tmp_path / "a.npy").write_bytes(huge)
    with pytest.raises(SourceError):
        read_numbers(tmp_path / "a.npy", "poses")
