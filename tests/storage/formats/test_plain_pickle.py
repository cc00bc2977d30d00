"""Pickles as data: what numpy and Python write is read, and nothing in a file is ever called."""

from __future__ import annotations

import collections
import contextlib
import os
import pickle
import pickletools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.formats import plain_pickle
from posegaussian.storage.formats.plain_pickle import read_object, read_pickle
from posegaussian.storage.model.errors import SourceError

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)
CAMERAS = {
    "cams": {"K": [np.arange(9.0).reshape(3, 3)] * 2, "T": [np.array([[1500.0], [-20.0], [3e3]])]},
    "ims": [{"ims": ["Camera (1)/a_0001.jpg", "é.jpg"]}, {"ims": np.array(["x.jpg", "longer.jpg"])}],
    "mixed": np.array([{"a": (1, None, True)}, -2.5], dtype=object),
    "scalars": (np.float32(0.5), np.int64(-3), np.bool_(True), b"\x00\xff", 2**40),
    "columns": np.asfortranarray(np.arange(6, dtype=">i2").reshape(2, 3)),
    "empty": np.zeros((0, 3), np.float32),
    7: [],
}


def write(path: Path, raw: bytes) -> Path:
    path.write_bytes(raw)
    return path


def check(found: Any) -> None:
    np.testing.assert_array_equal(found["cams"]["K"], [np.arange(9.0).reshape(3, 3)] * 2)
    np.testing.assert_array_equal(found["cams"]["T"][0], [[1500], [-20], [3e3]])
    assert [f["ims"] for f in found["ims"]] == [["Camera (1)/a_0001.jpg", "é.jpg"], ["x.jpg", "longer.jpg"]]
    assert found["mixed"] == [{"a": [1, None, True]}, -2.5]
    assert found["scalars"] == [0.5, -3, True, b"\x00\xff", 2**40]
    np.testing.assert_array_equal(found["columns"], np.arange(6).reshape(2, 3))
    assert (found["empty"].shape, found[7]) == ((0, 3), [])


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("core", ["numpy.core", "numpy._core"])
def test_what_numpy_and_python_write_is_read(tmp_path: Path, protocol: int, core: str) -> None:
    """Files of numpy 1 name numpy.core, those of numpy 2 numpy._core; a short name changes its length, too."""
    raw = pickle.dumps(CAMERAS, protocol)
    if protocol in (2, 3):  # names end with a line there
        raw = raw.replace(b"cnumpy._core.", b"c" + core.encode() + b".")
    check(read_pickle(write(tmp_path / "a.pkl", raw), "cameras"))


def test_an_npy_of_one_object_is_read(tmp_path: Path) -> None:
    np.save(tmp_path / "annots.npy", CAMERAS, allow_pickle=True)  # type: ignore[arg-type]
    check(read_object(tmp_path / "annots.npy", "cameras"))
    np.save(tmp_path / "plain.npy", np.zeros(3))
    with pytest.raises(SourceError, match=r"plain.npy: it holds \(3,\) of <f8, one object \(\) of \|O is expected"):
        read_object(tmp_path / "plain.npy", "cameras")


def test_a_pickle_of_python_2_is_read(tmp_path: Path) -> None:
    """Texts and the numbers of arrays are strings of bytes there; this is what its cPickle wrote of
    {'camera_c': numpy.array([0.5, -2.0]), 'width': 1080}."""
    raw = (
        b"\x80\x02}q\x01(U\x08camera_cq\x02cnumpy.core.multiarray\n_reconstruct\nq\x03cnumpy\nndarray\nq\x04K\x00\x85U"
        b"\x01b\x87Rq\x05(K\x01K\x02\x85cnumpy\ndtype\nq\x06U\x02f8K\x00K\x01\x87Rq\x07(K\x03U\x01<NNNJ\xff\xff\xff\xff"
        b"J\xff\xff\xff\xffK\x00tb\x89U\x10\x00\x00\x00\x00\x00\x00\xe0?\x00\x00\x00\x00\x00\x00\x00\xc0tbU\x05widthM8"
        b"\x04u."
    )
    found = read_pickle(write(tmp_path / "camera.pkl", raw), "camera")
    np.testing.assert_array_equal(found["camera_c"], [0.5, -2])
    assert found["width"] == 1080


class Runs:
    """Whatever `__reduce__` returns is called by Python's unpickler."""

    def __init__(self, *reduced: Any) -> None:
        self.reduced = reduced

    def __reduce__(self) -> tuple[Any, ...]:
        return self.reduced


class OfClass:
    """Made by its name, then given a state."""


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_nothing_is_called(tmp_path: Path, protocol: int) -> None:
    planted = tmp_path / "planted"
    for thing, named in (
        (Runs(os.system, (f"touch {planted}",)), "posix.system"),
        (Runs(eval, (f"open({str(planted)!r}, 'w')",)), "eval"),
        (Runs(planted.touch, ()), "getattr"),
        (Runs(np.load, (str(planted),)), "numpy.load"),
        (Runs(np.ndarray, ((10**6,),)), "calls a name in a way that numpy does not"),
        (Runs(pickle.loads, (b"",)), "pickle.loads"),
        (Runs(list, (), None, iter([Runs(os.system, (f"touch {planted}",))])), "list"),
        (collections.OrderedDict(a=1), "collections.OrderedDict"),
        (OfClass(), "OfClass|copy_reg|copyreg"),
        ({1, 2}, "set|EMPTY_SET"),
        (1 + 2j, "complex"),
    ):
        with pytest.raises(SourceError, match=rf"cannot read cameras .*bad\.pkl: .*({named})"):
            read_pickle(write(tmp_path / "bad.pkl", pickle.dumps({"a": [thing]}, protocol)), "cameras")
        assert not planted.exists()
    read_pickle(write(tmp_path / "bad.pkl", pickle.dumps({"a": ["os.system"]}, protocol)), "cameras")


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (b"(S'touch planted'\nios\nsystem\n.", "INST os system"),
        (b"(cos\nsystem\nS'touch planted'\no.", r"asks for 'os\.system'"),
        (b"\x80\x02cos\nsystem\n)\x81.", r"asks for 'os\.system'"),
        (b"\x80\x02cnumpy\nndarray\n)\x81.", "NEWOBJ"),
        (b"\x80\x04\x8c\x02os\x8c\x06system\x93.", r"asks for 'os\.system'"),
        (b"\x80\x04]\x8c\x06system\x93.", "a name that is no text"),
        (b"Pplanted\n.", "PERSID planted"),
        (b"\x80\x02\x82\x01.", "EXT1 1"),
        (b"\x80\x05\x97.", "NEXT_BUFFER"),
        (b"cnumpy.core.multiarray\nscalar\n.", "a name of numpy in the place of a value"),
        (b"cnumpy.f2py\nrun_main\n.", r"asks for 'numpy\.f2py\.run_main'"),
        (b"cnumpy.core.multiarray\n_reconstruct.__globals__\n.", "_reconstruct.__globals__"),
        (b"ctorch._utils\n_rebuild_tensor_v2\n.", r"asks for 'torch\._utils\._rebuild_tensor_v2'"),
        (b"cchumpy.ch\nCh\n.", r"asks for 'chumpy\.ch\.Ch'"),
        (b"]", "damaged or cut off"),
        (b"", "damaged or cut off"),
        (b"K\x01K\x02b.", "sets the state of what has none"),
        (b"0.", "damaged or cut off"),
        (b"h\x05.", "damaged or cut off"),
        (b"K\x01a.", "damaged or cut off"),
        (b"}(]K\x01u.", "holds the key 'list'"),
        (b"\x80\x02\x8bX\x00\x00\x00" + bytes(87) + b"\x01.", "whole number of more than 18 digits"),
        (b"I" + b"9" * 5000 + b"\n.", "damaged or cut off"),
        (b"\x80\x02" + b"N" * 200_005 + b".", "over 200000 instructions"),
        (b")" + b"\x85" * 100_000 + b".", "nested more than 32 deep"),
        (b"]\x94]\x94h\x00a" + b"h\x00a" * 3 + b"h\x01h\x00ah\x00h\x01a.", "nested more than 32 deep"),
        (b"]\x94" + b"".join(b"](" + bytes([104, n]) * 9 + b"e\x94" for n in range(20)) + b".", "than 200000 values"),
    ],
)  # fmt: skip
def test_hostile_instructions_get_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, raw: bytes, said: str
) -> None:
    monkeypatch.setattr(plain_pickle, "MOST_STEPS", 200_000)
    monkeypatch.setattr(plain_pickle, "MOST_VALUES", 200_000)
    with pytest.raises(SourceError, match=said):
        read_pickle(write(tmp_path / "bad.pkl", raw), "cameras")


def array(kind: bytes, shape: tuple[int, ...], data: bytes) -> bytes:
    """A pickle of numpy's `_frombuffer`."""
    sizes = b"".join(b"\x8a\x08" + n.to_bytes(8, "little") for n in shape)
    named = b"\x80\x05cnumpy._core.numeric\n_frombuffer\n(B" + len(data).to_bytes(4, "little") + data
    return (
        named + b"cnumpy\ndtype\nX" + len(kind).to_bytes(4, "little") + kind + b"\x85R(" + sizes + b"tX\x01\0\0\0CtR."
    )


def test_an_array_has_no_more_than_its_bytes(tmp_path: Path) -> None:
    assert len(read_pickle(write(tmp_path / "a.pkl", array(b"f8", (2, 1), bytes(16))), "cameras")) == 2
    for kind, shape, data in (
        (b"f8", (10**9,), bytes(16)),
        (b"f8", (10**17, 10**17), bytes(16)),
        (b"f8", (2,) * 9, bytes(4096)),
        (b"U1", (2_000_000,), bytes(8_000_000)),
        (b"V8", (1,), bytes(8)),
        (b"M8", (1,), bytes(8)),
        (b"f3", (1,), bytes(3)),
        (b"O8", (1,), bytes(8)),
        (b"U0", (10**9,), b""),
        (b"i4,i4", (1,), bytes(8)),
    ):
        with pytest.raises(SourceError, match=r"cannot read cameras .*bad\.pkl: .*; it is damaged or cut off"):
            read_pickle(write(tmp_path / "bad.pkl", array(kind, shape, data)), "cameras")


def test_a_large_file_is_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "big.pkl", pickle.dumps(bytes(1000)))
    with pytest.raises(SourceError, match=r"it has 1\d\d\d bytes, at most 1000 are read"):
        read_pickle(path, "cameras", largest=1000)


def test_every_instruction_of_python_is_read_or_refused(tmp_path: Path) -> None:
    """Each alone, with what a short file can give it."""
    for op in pickletools.opcodes:
        for raw in (op.code.encode("latin1") + b"1\n1\n" + bytes(20) + b".", b"]](" + op.code.encode("latin1") + b"."):
            with contextlib.suppress(SourceError):
                read_pickle(write(tmp_path / "a.pkl", raw), "cameras")
