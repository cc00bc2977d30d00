"""Ways to spoil one file of a capture, each chosen by a random generator of the variant's own:
the same number, the same damage."""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

NUMBERS = (
    "1e12", "-1", "0", "-0.0", "NaN", "nan", "Infinity", "-inf", ".inf", "1e308", "-1e308", "1e999", "1e-320", "9" * 25,
    "9" * 400, "9" * 5000, "1" + "0" * 4299,
    "2147483648", "-9223372036854775809", "18446744073709551616", "0.5", "3.7e5", "1e5", "true", "null", "[]", "{}",
    '""', '"text"', "[[1, 2], [3]]", "1,5", "0x10", "1e", "--1", "1_0",
)  # fmt: skip
"""What may stand in the place of a number."""
WORDS = (
    "",
    ".",
    "..",
    "../../../planted",
    "../../outside/planted",
    "{outside}/planted",
    "a/b",
    "nul\\u0000l",
    "x" * 300,
    "x" * 70000,
    "\\ud800",
    "\\u202e",
    "é",
    "*",
    "cam1",
    "0",
    "-",
    " ",
    "\\n",
    "%s%n",
    "~",
    "CON",
    "null",
    "true",
    "1e400",
)
"""What may stand in the place of a text."""
EXTREME = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
"""What may stand in the place of four bytes."""
NOT_UTF8 = (b"\xff\xfe\xfa", b"\xc3\x28", b"\x80", b"\xed\xa0\x80", b"\xf8\x88\x80\x80\x80", b"caf\xe9")
DEEP = 100_000
"""Nesting that no stack holds."""

Spoiler = Callable[[bytes, Random], bytes]


def _at(raw: bytes, random: Random) -> int:
    """A place, more often within the first kilobyte, where headers are."""
    return (
        random.randrange(max(1, min(len(raw), 1024))) if random.random() < 0.6 else random.randrange(max(1, len(raw)))
    )


def flip(raw: bytes, random: Random) -> bytes:
    out = bytearray(raw)
    for _ in range(random.choice((1, 1, 2, 8, 64))):
        if out:
            out[_at(raw, random)] ^= 1 << random.randrange(8)
    return bytes(out)


def cut(raw: bytes, random: Random) -> bytes:
    return raw[: random.choice((0, 1, _at(raw, random), len(raw) - 1))]


def insert(raw: bytes, random: Random) -> bytes:
    at = _at(raw, random)
    return raw[:at] + random.choice((random.randbytes(random.choice((1, 7, 300))), bytes(50), *NOT_UTF8)) + raw[at:]


def take_out(raw: bytes, random: Random) -> bytes:
    at = _at(raw, random)
    return raw[:at] + raw[at + random.choice((1, 4, 100, 3000)) :]


def double(raw: bytes, random: Random) -> bytes:
    at, long = _at(raw, random), random.choice((4, 60, 2000))
    return raw[: at + long] + raw[at : at + long] * random.choice((1, 50)) + raw[at + long :]


def overwrite(raw: bytes, random: Random) -> bytes:
    at = _at(raw, random)
    new = random.choice(
        (
            struct.pack(random.choice("<>") + "I", random.choice(EXTREME)),
            b"\xff" * 30,
            bytes(30),
            struct.pack("<d", float("nan")),
            random.choice(NOT_UTF8),
        )
    )
    return raw[:at] + new + raw[at + len(new) :]


def letters(raw: bytes, random: Random) -> bytes:
    """Spoil a run of letters, such as a tag or the name of a codec."""
    found = list(re.finditer(rb"[A-Za-z_][A-Za-z0-9_]{2,}", raw))
    if not found:
        return flip(raw, random)
    m = random.choice(found)
    new = random.choice((random.choice(NOT_UTF8), m[0].swapcase(), bytes(len(m[0])), m[0][::-1]))
    return raw[: m.start()] + new[: len(m[0])].ljust(len(m[0]), b"\xe9") + raw[m.end() :]


BINARY: tuple[Spoiler, ...] = (flip, flip, cut, insert, take_out, double, overwrite, overwrite, overwrite, letters)


def number(raw: bytes, random: Random) -> bytes:
    return _replaced(raw, random, rb"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?", lambda _: random.choice(NUMBERS))


def many_numbers(raw: bytes, random: Random) -> bytes:
    new = random.choice(("1e12", "1e308", "-1e308", "NaN", "0", "1e-300", "9" * 25, "3000", "-7"))
    return re.sub(rb"-?\d+\.\d*(?:[eE][-+]?\d+)?", new.encode(), raw)


def word(raw: bytes, random: Random) -> bytes:
    return _replaced(raw, random, rb'(?<=")[^"\n]*(?=")|[A-Za-z_][\w.]*', lambda _: random.choice(WORDS))


def _replaced(raw: bytes, random: Random, pattern: bytes, new: Callable[[bytes], str]) -> bytes:
    found = list(re.finditer(pattern, raw))
    if not found:
        return insert(raw, random)
    m = random.choice(found)
    return raw[: m.start()] + new(m[0]).encode() + raw[m.end() :]


def lines(raw: bytes, random: Random) -> bytes:
    """Take lines out, double them, exchange two."""
    found = raw.split(b"\n")
    a, b = random.randrange(len(found)), random.randrange(len(found))
    how = random.randrange(4)
    if how == 0:
        del found[min(a, b) : max(a, b) + 1]
    elif how == 1:
        found[a:a] = [found[b]] * random.choice((1, 1000))
    elif how == 2:
        found[a], found[b] = found[b], found[a]
    else:
        found[a] = found[a][: random.randrange(len(found[a]) + 1)]
    return b"\n".join(found)


def encoding(raw: bytes, random: Random) -> bytes:
    text = raw.decode("utf-8", "replace")
    at = random.randrange(len(raw) + 1)
    return random.choice(
        (
            raw[:at] + random.choice(NOT_UTF8) + raw[at:],
            text.encode("utf-16"),
            text.encode("utf-32"),
            b"\xef\xbb\xbf" + raw,
            raw.replace(b"\n", b"\r"),
            raw.replace(b"\n", b"\0"),
            raw[:at] + b"\0" + raw[at:],
        )
    )


def deep(raw: bytes, random: Random) -> bytes:
    """Nesting without end, at the start or in the place of a number."""
    one = random.choice(("[", '{"a":', "[[", "{a: ", "- ", "? ", "(", "<a>", "{"))
    nested = one * random.choice((40, 1000, DEEP))
    return nested.encode() if random.random() < 0.5 else _replaced(raw, random, rb"-?\d+\.?\d*", lambda _: nested)


TEXT: tuple[Spoiler, ...] = (
    flip,
    cut,
    insert,
    take_out,
    number,
    number,
    number,
    many_numbers,
    word,
    word,
    lines,
    encoding,
    deep,
)


def json_node(raw: bytes, random: Random) -> bytes:
    """Replace, double or remove one node of a JSON document."""
    data = json.loads(raw)
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for k, v in node.items() if isinstance(node, dict) else enumerate(node):
            places.append((node, k))
            if isinstance(v, dict | list):
                walk(v)

    walk(data)
    if not places:
        return raw
    holder, key = random.choice(places)
    wrong = random.choice(
        (
            None,
            True,
            -1,
            0,
            1e308,
            -1e308,
            10**25,
            10**400,
            float("nan"),
            float("inf"),
            "",
            "text",
            "../../planted",
            [],
            {},
            [[]],
            [None],
            {"a": [1]},
            [1, 2, 3, 4],
            "x" * 100_000,
            [[1.0] * 3] * 3,
        )
    )
    how = random.random()
    if how < 0.7:
        holder[key] = wrong
    elif how < 0.85:
        del holder[key]
    elif isinstance(holder, list):
        holder.extend([holder[key]] * random.choice((1, 30, 1000)))
    else:
        holder["another"] = holder[key]
    return json.dumps(data).encode()


ANCHORS = "abcdefghijklmnopqrstuvwxyz"
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in pairwise(ANCHORS)
)
"""YAML of a kilobyte that stands for 9^26 values."""


def yaml_bomb(raw: bytes, random: Random) -> bytes:
    text = raw.decode("utf-8", "replace")
    hostile = (
        "x: &x {y: *x}\n",
        "x: !!python/object/apply:os.system ['touch {outside}/planted']\n",
        "? [a, b]\n: 1\n",
        "!!binary x: 1\n",
        "<<: {a: 1}\n",
        "x: !!timestamp 2020-99-99\n",
        "x: 1:2:3:4\n",
        "x: *unknown\n",
        "--- \n---\n",
        "%YAML 9.9\n",
        "x: !!set {a, b}\n",
    )
    return random.choice(
        (
            BOMB,
            BOMB + text,
            text + BOMB,
            *(h + text for h in hostile),
            *(text + h for h in hostile),
            "x: " + "9" * 5000 + "\n" + text,
        )
    ).encode()


def toml_bomb(raw: bytes, random: Random) -> bytes:
    text = raw.decode("utf-8", "replace")
    keys = (
        ".".join(["a"] * 50_000) + " = 1\n",
        "[" + ".".join(["a"] * 50_000) + "]\n",
        ". ".join(['"b"'] * 3000) + " = 2\n",
        "".join(f"{'.'.join(['c'] * 30)}.k{i} = 1\n" for i in range(3000)),
        "".join(f"[[d{i}.e]]\n" for i in range(9000)),
    )
    return random.choice(
        (
            *(k + text for k in keys),
            text + "date = 1979-05-27\n",
            text.replace("translation = ", "translation = 1979-05-27 # "),
            text.replace("size = ", "size = {a = 1} # "),
        )
    ).encode()


def xml_bomb(raw: bytes, random: Random) -> bytes:
    text = raw.decode("utf-8", "replace")
    entities = '<!ENTITY a "aaaaaaaaaa">' + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in pairwise(ANCHORS))
    return random.choice(
        (
            f"<!DOCTYPE x [{entities}]><x>&z;</x>",
            f'<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>{text}',
            f"<?xml version='1.0' encoding='no-such'?>{text}",
            f"<?xml version='1.0' encoding='utf-7'?>{text}",
            "<a>" * DEEP,
            text * 3,
        )
    ).encode()


PICKLES = (
    b"cos\nsystem\n(S'touch {outside}/planted'\ntR.",
    b"(S'touch {outside}/planted'\nios\nsystem\n.",
    b"(cos\nsystem\nS'touch {outside}/planted'\no.",
    b'cbuiltins\neval\n(S\'open("{outside}/planted", "w")\'\ntR.',
    b"cpathlib\nPath\n(S'{outside}/planted'\ntRctouch\n\n.",
    b"cnumpy\nfromfile\n(S'/dev/zero'\ntR.",
    b"cnumpy\nndarray\n((I1000000000\nI1000000000\ntl.",
    b"\x80\x02cnumpy\nndarray\n)\x81}S'__class__'\nNsb.",
    b"ctorch._utils\n_rebuild_tensor_v2\n.",
    b"cnumpy.core.multiarray\nscalar\n(cnumpy\ndtype\n(S'U99999999'\ntRS''\ntR.",
    b"Pplanted\n.",
    b"\x80\x05\x95" + b"\xff" * 8 + b"\x8e" + b"\xff" * 8 + b".",
    b")" + b"\x85" * DEEP + b".",
    b"]" * DEEP + b"a" * (DEEP - 1) + b".",
    b"]\x94" + b"".join(b"](" + bytes([104, n]) * 9 + b"e\x94" for n in range(26)) + b".",
    b"]\x94h\x00a.",
    b"N" * 4_000_000 + b".",
    b"I" + b"9" * 5000 + b"\n.",
)
"""Pickles that run code, stand for gigabytes, or are nested for ever."""


def pickle_bomb(raw: bytes, random: Random) -> bytes:
    """A hostile pickle in the place of the whole one, behind a .npy file's header, or in the place of its end."""
    start = raw.find(b"\n") + 1 if raw.startswith(b"\x93NUMPY") else 0
    hostile = random.choice(PICKLES)
    return random.choice(
        (raw[:start] + hostile, raw[:-1] + hostile, raw[: random.randrange(start, len(raw))] + hostile)
    )


STRUCTURE: dict[str, tuple[Spoiler, ...]] = {
    "json": (json_node,) * 8,
    "yaml": (yaml_bomb,) * 3,
    "toml": (toml_bomb,) * 3,
    "xml": (xml_bomb,) * 3,
    "pickle": (pickle_bomb,) * 8,
    "table": (),
    "binary": (),
}
"""What only the format's own grammar makes possible."""


def pipe(file: Path, random: Random) -> None:
    os.mkfifo(file)


def endless(file: Path, random: Random) -> None:
    file.symlink_to(random.choice(("/dev/zero", "/dev/urandom", "/dev/tty", "/dev/full")))


def loop(file: Path, random: Random) -> None:
    file.symlink_to(file)


def folder(file: Path, random: Random) -> None:
    file.mkdir()


def nothing(file: Path, random: Random) -> None:
    """The file is gone."""


def swapped(file: Path, random: Random) -> None:
    """Another file of the capture under its name."""
    others = sorted(p for p in file.parents[1].rglob("*") if p.is_file() and p != file) or [Path(__file__)]
    shutil.copyfile(random.choice(others), file)


def empty(file: Path, random: Random) -> None:
    file.touch()


def foreign(file: Path, random: Random) -> None:
    file.write_bytes(random.randbytes(random.choice((10, 5000))))


WHOLE: tuple[Callable[[Path, Random], None], ...] = (pipe, endless, loop, folder, nothing, swapped, empty, foreign)
"""What may lie where the file was."""


def spoil(file: Path, kind: str, outside: Path, random: Random) -> str:
    """Spoil one file in place; returns what was done. `outside` is where hostile names point."""
    if random.random() < 0.12:
        how = random.choice(WHOLE)
        file.unlink()
        how(file, random)
        return f"{file.name}: {how.__name__}"
    ways = (BINARY if kind in ("binary", "pickle") else TEXT) + STRUCTURE[kind]
    done = []
    raw = file.read_bytes()
    for _ in range(random.choice((1, 1, 1, 2))):
        way = random.choice(ways)
        try:
            raw = way(raw, random)
        except (ValueError, RecursionError):  # a document that the way before has broken
            raw = flip(raw, random)
        done.append(way.__name__)
    file.unlink()  # it may be a link to the original
    file.write_bytes(raw.replace(b"{outside}", str(outside).encode()))
    return f"{file.name}: {', '.join(done)}"


def rename(root: Path, random: Random) -> str:
    """Give a file or folder of a capture a hostile name."""
    chosen = random.choice(sorted(p for p in root.rglob("*")))
    new = random.choice(
        (
            "",
            "..x",
            "-",
            " ",
            "a b",
            "é" * 20,
            "\udcff",
            "\n",
            "9" * 30,
            "000000",
            "x" * 200,
            "*",
            "?",
            "%s",
            "cam1",
            ".hidden",
            "~",
            "nul",
            "1e9",
            "-5",
            "0_0",
        )
    ) + random.choice(("", chosen.suffix))
    target = chosen.with_name(new or "_")
    if target.exists():
        shutil.rmtree(chosen) if chosen.is_dir() else chosen.unlink()
        return f"{chosen.name}: gone"
    chosen.rename(target)
    return f"{chosen.name}: renamed {new!r}"
