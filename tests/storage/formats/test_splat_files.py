"""Splat files: real ones come back bit for bit, packed ones equal a plain decoding,
foreign and broken ones are named."""

import math
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.formats.compressed_splat_ply import OPAQUE, PACKED
from posegaussian.storage.formats.ply import read_ply
from posegaussian.storage.formats.splat_ply import NEEDED, read_splats, write_splats
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.splats import SH0, Splats

FOLDER = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "reference" / "splats"


def real(name: str) -> Path:
    if not (FOLDER / name).exists():
        pytest.skip(f"{FOLDER / name} is not here; set POSEGAUSSIAN_CAPTURES to the folder that holds reference/")
    return FOLDER / name


def made(n: int = 7, degree: int = 2, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        *(rng.normal(size=s).astype(np.float32) for s in ((n, 3), (n, 3), (n, 4), (n,), (n, (degree + 1) ** 2, 3)))
    )


def same(a: Splats, b: Splats) -> bool:
    return all(np.array_equal(getattr(a, f), getattr(b, f), equal_nan=True) for f in Splats.__dataclass_fields__)


def ply(path: Path, *lines: str, body: bytes = b"") -> Path:
    path.write_bytes("\n".join(["ply", *lines, "end_header", ""]).encode() + body)
    return path


LITTLE = "format binary_little_endian 1.0"


def test_a_standard_file_comes_back_bit_for_bit(tmp_path: Path) -> None:
    source = real("fruit_drops_minimal.ply")
    read = read_splats(source)
    assert (len(read.splats), read.splats.degree) == (4721, 3)
    norm = np.linalg.norm(read.splats.quaternion, axis=1)
    assert norm.min() == pytest.approx(0.6, abs=0.1)  # as the folder's notes say
    assert norm.max() == pytest.approx(1.93, abs=0.01)
    write_splats(tmp_path / "copy.ply", read.splats, read.carried)
    assert (tmp_path / "copy.ply").read_bytes() == source.read_bytes()
    write_splats(tmp_path / "plain.ply", read.splats)
    assert same(read_splats(tmp_path / "plain.ply").splats, read.splats)


def test_higher_harmonics_are_sorted_by_colour_in_the_file() -> None:
    source = real("fruit_drops_minimal.ply")
    table, splats = read_ply(source).elements["vertex"], read_splats(source).splats
    np.testing.assert_array_equal(splats.harmonics[:, 1, 0], table["f_rest_0"])
    np.testing.assert_array_equal(splats.harmonics[:, 15, 0], table["f_rest_14"])
    np.testing.assert_array_equal(splats.harmonics[:, 1, 1], table["f_rest_15"])
    np.testing.assert_array_equal(splats.harmonics[:, 15, 2], table["f_rest_44"])


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [0, 1, 300])
def test_what_is_written_is_read(tmp_path: Path, n: int, degree: int) -> None:
    splats = made(n, degree)
    if n:
        splats.mean[0, 0], splats.opacity_logit[0] = np.nan, np.inf  # kept as it is: the rasterizer masks it
    write_splats(tmp_path / "a.ply", splats)
    read = read_splats(tmp_path / "a.ply")
    assert same(read.splats, splats)
    write_splats(tmp_path / "b.ply", read.splats, read.carried)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    assert (read.carried.elements["vertex"]["nx"] == 0).all()  # type: ignore[union-attr]


def test_order_further_properties_and_comments_are_carried(tmp_path: Path) -> None:
    names = ["label", *reversed(NEEDED), "extra"]
    types = ["uchar", *["float"] * len(NEEDED), "double"]
    table = np.zeros(
        3, [(n, {"uchar": "u1", "float": ">f4", "double": ">f8"}[t]) for n, t in zip(names, types, strict=True)]
    )
    rng = np.random.default_rng(1)
    for name in names:
        table[name] = rng.uniform(0, 200, 3)
    path = ply(
        tmp_path / "x.ply",
        "format binary_big_endian 1.0",
        "comment made by hand",
        "element vertex 3",
        *(f"property {t} {n}" for n, t in zip(names, types, strict=True)),
        body=table.tobytes(),
    )
    read = read_splats(path)
    np.testing.assert_array_equal(read.splats.mean[:, 2], table["z"].astype(np.float32))
    write_splats(tmp_path / "y.ply", read.splats, read.carried)
    assert (tmp_path / "y.ply").read_bytes() == path.read_bytes()
    with pytest.raises(ValueError, match="write without it"):
        write_splats(tmp_path / "y.ply", made(4, 0), read.carried)


def decoded_by_hand(path: Path, i: int) -> tuple[list[float], ...]:
    """One Gaussian of a compressed file of chunk and vertex alone, by the format's description,
    with struct and no numpy."""
    raw = path.read_bytes()
    start = raw.index(b"end_header\n") + 11
    chunks = next(
        int(line.split()[2]) for line in raw[:start].decode().splitlines() if line.startswith("element chunk")
    )
    bounds = struct.unpack_from("<18f", raw, start + 72 * (i // 256))
    position, rotation, scale, color = struct.unpack_from("<4I", raw, start + 72 * chunks + 16 * i)

    def triple(v: int, at: int) -> list[float]:
        return [
            bounds[at + k] + (bounds[at + 3 + k] - bounds[at + k]) * s
            for k, s in enumerate(((v >> 21) / 2047, (v >> 11 & 1023) / 1023, (v & 2047) / 2047))
        ]

    rest = [((rotation >> s & 1023) / 1023 - 0.5) * math.sqrt(2) for s in (20, 10, 0)]
    q = list(rest)
    q.insert(rotation >> 30, math.sqrt(max(0, 1 - sum(r * r for r in rest))))
    dc = [
        (bounds[12 + k] + (bounds[15 + k] - bounds[12 + k]) * (color >> (24 - 8 * k) & 255) / 255 - 0.5) / SH0
        for k in range(3)
    ]
    return triple(position, 0), triple(scale, 6), q, dc, [(color & 255) / 255]


def test_a_compressed_file_equals_its_decoded_values(tmp_path: Path) -> None:
    source = real("guitar.compressed.ply")
    read = read_splats(source)
    s = read.splats
    assert (len(s), s.degree, read.carried) == (90854, 0, None)
    for i in (*range(0, len(s), 997), 255, 256, len(s) - 1):
        mean, scale, q, dc, alpha = decoded_by_hand(source, i)
        # float32 of values up to 20
        for found, expected in (
            (s.mean[i], mean),
            (s.log_scale[i], scale),
            (s.quaternion[i], q),
            (s.harmonics[i, 0], dc),
            (1 / (1 + np.exp(-s.opacity_logit[i])), alpha),
        ):
            np.testing.assert_allclose(found, np.squeeze(expected), atol=2e-6)
    write_splats(tmp_path / "standard.ply", s)
    assert same(read_splats(tmp_path / "standard.ply").splats, s)


def packed(path: Path, n: int = 3, chunks: int = 1, sh: int = 0, colors: bool = False, color: int = 0x80FF0080) -> Path:
    bounds = [
        f"{end}_{axis}"
        for axis in ("x", "y", "z", "scale_x", "scale_y", "scale_z", *("rgb" if colors else ""))
        for end in ("min", "max")
    ]
    body = (
        np.tile(np.array([-1, 3], "<f4"), len(bounds) // 2 * chunks).tobytes()
        + np.tile(np.array([2**32 - 1, 2 << 30, 0, color], "<u4"), n).tobytes()
        + bytes([0, 255, 127] * (sh // 3)) * n
    )
    higher = [f"element sh {n}", *(f"property uchar f_rest_{i}" for i in range(sh))] if sh else []
    return ply(
        path,
        LITTLE,
        f"element chunk {chunks}",
        *(f"property float {b}" for b in bounds),
        f"element vertex {n}",
        *(f"property uint {p}" for p in PACKED),
        *higher,
        body=body,
    )


def test_packed_values_at_their_ends(tmp_path: Path) -> None:
    s = read_splats(packed(tmp_path / "p.ply", sh=9)).splats
    np.testing.assert_array_equal(s.mean, 3)
    np.testing.assert_array_equal(s.log_scale, -1)
    np.testing.assert_allclose(s.harmonics[0, 0], (np.array([128 / 255, 1, 0]) - 0.5) / SH0, atol=1e-6)
    np.testing.assert_allclose(
        s.harmonics[0, 1:], np.array([[-4, -4, -4], [4, 4, 4], [-1 / 64, -1 / 64, -1 / 64]]), atol=1e-6
    )
    assert s.quaternion[0, 2] == 0  # three components at -1/sqrt(2) leave nothing for the largest, and no NaN
    with_bounds = read_splats(packed(tmp_path / "c.ply", colors=True)).splats
    np.testing.assert_allclose(
        with_bounds.harmonics[0, 0], (np.array([-1 + 4 * 128 / 255, 3, -1]) - 0.5) / SH0, rtol=1e-6
    )
    for alpha, logit in ((0, -OPAQUE), (255, OPAQUE)):
        s = read_splats(packed(tmp_path / "a.ply", color=alpha)).splats
        assert (s.opacity_logit == logit).all()


def test_broken_and_foreign_files_are_named_with_line_or_byte(tmp_path: Path) -> None:
    whole = tmp_path / "whole.ply"
    write_splats(whole, made(5, 0))
    raw = whole.read_bytes()

    def says(data: bytes | Path, *words: str) -> None:
        path = data if isinstance(data, Path) else tmp_path / "broken.ply"
        if isinstance(data, bytes):
            path.write_bytes(data)
        with pytest.raises(SourceError) as error:
            read_splats(path)
        for word in (str(path), *words):
            assert word in str(error.value), error.value

    says(raw[:-1], f"ends at byte {len(raw) - 1}", "5 rows of 68 bytes", "copy it again")
    says(raw + b"12", "2 bytes are left")
    says(raw[:40], "end_header")
    says(b"", "byte 0")
    says(b"solid cube", "byte 0", "solid")
    says(raw.replace(b"binary_little_endian", b"ascii"), "line 2", "binary_little_endian")
    says(raw.replace(b"element vertex 5", b"element vertex five"), "line 3", "NAME COUNT")
    says(raw.replace(b"property float x", b"property list uchar int x"), "line 4", "TYPE NAME")
    says(raw.replace(b"property float y\n", b"property float x\n"), "line 5", "already")
    says(raw.replace(b"property float opacity", b"property float opaqueness"), "lacks opacity", "packed_position")
    says(raw.replace(b"format binary_little_endian 1.0\n", b""), "no line 'format'")
    says(raw.replace(b"property float nx", b"property floaty"), "line 7")
    says(raw.replace(b"property float nx", b"proportion 1 1"), "line 7", "is expected")
    says(raw.replace(b"element vertex 5", b"element points 5"), "no element 'vertex'")
    says(
        ply(
            tmp_path / "mesh.ply", LITTLE, "element vertex 0", "property float x", "element face 0", "property uchar n"
        ),
        "lacks y, z",
        "a mesh",
    )
    says(raw.replace(b"property float f_dc_0", b"property int f_dc_0"), "f_dc_0 is int32", "float is expected")
    write_splats(whole, made(5, 1))
    says(whole.read_bytes().replace(b"f_rest_8\n", b"f_rust_8\n"), "8 properties f_rest_*", "0, 9, 24, 45")
    says(whole.read_bytes().replace(b"f_rest_0\n", b"f_rest_99\n"), "numbered from 0")
    says(packed(tmp_path / "few.ply", n=300), "need 2 rows of element chunk", "found 1")
    says(packed(tmp_path / "sh.ply", sh=12), "element sh", "9, 24 or 45")
    text = packed(tmp_path / "lack.ply").read_bytes().replace(b"min_scale_y", b"min_shape_y")
    says(text, "chunk lacks min_scale_y")


def test_arrays_that_do_not_belong_together_are_refused() -> None:
    good = made(3, 1)
    with pytest.raises(ValueError, match="log_scale is float32"):
        Splats(good.mean, good.log_scale[:2], good.quaternion, good.opacity_logit, good.harmonics)
    with pytest.raises(ValueError, match="float64"):
        Splats(good.mean.astype(np.float64), good.log_scale, good.quaternion, good.opacity_logit, good.harmonics)
    with pytest.raises(ValueError, match="2 coefficients"):
        Splats(good.mean, good.log_scale, good.quaternion, good.opacity_logit, good.harmonics[:, :2])
