"""What a stranger's file may do to a reader: nothing but a sentence, soon, and without taking memory."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from posegaussian.dags.config.yaml_source import load
from posegaussian.storage.formats.ply import read_ply
from posegaussian.storage.model import documents
from posegaussian.storage.model.capture import SourceFile
from posegaussian.storage.model.documents import read_json, read_table, read_text, read_toml, read_xml, regular
from posegaussian.storage.model.errors import ConfigError, SourceError
from posegaussian.storage.model.yaml_documents import read_yaml, yaml_text
from posegaussian.storage.readers.images import picture_size
from posegaussian.storage.readers.video import VideoFile

READERS: dict[str, Callable[[Path], Any]] = {
    "json": read_json, "toml": read_toml, "xml": read_xml, "yaml": read_yaml, "table": read_table, "text": read_text,
    "configuration": load, "picture": picture_size, "video": VideoFile, "ply": read_ply, "source": SourceFile.of,
}  # fmt: skip


@pytest.mark.timeout(20)
@pytest.mark.parametrize("reader", READERS)
def test_only_regular_files_are_opened(tmp_path: Path, reader: str) -> None:
    pipe, endless, gone = tmp_path / "pipe.png", tmp_path / "endless.png", tmp_path / "gone.png"
    os.mkfifo(pipe)
    endless.symlink_to("/dev/zero")
    for path, what in (
        (pipe, "it is a pipe"),
        (endless, "it is a device"),
        (tmp_path, "it is a folder"),
        (gone, "No such file"),
    ):
        with pytest.raises((SourceError, ConfigError), match=f"{path}: .*{what}" if path != tmp_path else what):
            READERS[reader](path)


def test_a_file_is_too_large_before_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / "large.toml"
    with file.open("wb") as f:
        f.truncate(10 * 2**30)  # a hole: it takes no disk
    for read in (read_toml, read_yaml, read_json, read_xml):
        with pytest.raises(SourceError, match=r"large.toml: it has 10737418240 bytes, at most \d+ are read"):
            read(file)


BOMB = "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
CHAIN = b"a0: &a0 [1]\n" + b"".join(b"a%d: &a%d [*a%d]\n" % (n, n, n - 1) for n in range(1, 40))
HOSTILE: dict[str, tuple[Callable[[Path], Any], bytes, str]] = {
    "json, deep": (read_json, b"[" * 100_000, "nested more than 32 deep"),
    "json, deep objects": (read_json, b'{"a":' * 33 + b"1" + b"}" * 33, "nested more than 32 deep"),
    "json, digits": (read_json, b'{"a": ' + b"9" * 400 + b"}", "has 400 digits, at most 18"),
    "json, broken": (read_json, b'{"a":\n  1,}', r":2:5: not valid JSON"),
    "json, not UTF-8": (read_json, b'{\n"a": "\xff"}', r"line 2 is not text in UTF-8 \(byte 8\)"),
    "json, NUL": (read_json, b"\0", "not valid JSON"),
    "toml, parts": (read_toml, b"x = 1\n" + b".".join([b"a"] * 50_000) + b" = 1\n", ":2: a key has more than 32 parts"),
    "toml, parts of a table": (
        read_toml,
        b"[" + b" . ".join([b'"a"'] * 5000) + b"]\n",
        ":1: a key has more than 32 parts",
    ),
    "toml, deep": (read_toml, b"a = " + b"[" * 5000, "nested more than 32 deep"),
    "toml, digits": (read_toml, b"a = [" + b"9" * 400 + b"]", "a whole number of about 398 digits"),
    "toml, broken": (read_toml, b"[a\n", "cannot be read: .*line 1"),
    "yaml, aliases": (
        read_yaml,
        BOMB.encode(),
        r":5:14: not valid YAML: more than 30000 values, counting all that aliases",
    ),
    "yaml, itself": (read_yaml, b"a: &x [*x]", r":1:8: not valid YAML: the alias \*x holds itself"),
    "yaml, deep": (read_yaml, b"[" * 5000, "nested more than 32 deep"),
    "yaml, deep by aliases": (read_yaml, CHAIN, "nested more than 32 deep"),
    "yaml, digits": (read_yaml, b"a: " + b"9" * 5000, "a whole number has 5000 digits"),
    "yaml, values": (read_yaml, b"a: [" + b"1," * 40_000 + b"]", "more than 30000 values"),
    "yaml, twice": (read_yaml, b"a: {b: 1, b: 2}", r":1:11: not valid YAML: 'b' is given twice"),
    "yaml, code": (read_yaml, b"!!python/object/apply:os.system ['true']", "could not determine a constructor"),
    "xml, entities": (read_xml, b'<!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>', "it declares a document type"),
    "xml, encoding": (read_xml, b"<?xml version='1.0' encoding='nope'?><x/>", "cannot be read"),
    "table, field": (
        lambda p: list(read_table(p)[1]),
        b"a,b\n" + b"x" * 200_000 + b",1\n",
        "line 1: field larger than field limit",
    ),
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("case", HOSTILE)
def test_what_would_take_time_or_memory_is_a_sentence(tmp_path: Path, case: str) -> None:
    reader, content, sentence = HOSTILE[case]
    file = tmp_path / "a.file"
    file.write_bytes(content)
    with pytest.raises(SourceError, match=sentence) as error:
        reader(file)
    assert str(file) in str(error.value)
    assert len(str(error.value)) < 1000


def test_a_configuration_with_exploding_aliases_says_where(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(BOMB)
    with pytest.raises(ConfigError, match=r"own\.yaml:5:14: not valid YAML: more than 30000 values"):
        load(file)


def test_what_is_ordinary_is_read(tmp_path: Path) -> None:
    file = tmp_path / "a.file"
    for text, read, expected in (
        ('{"a": [1, -2.5, NaN, "x"], "b": 123456789012345678}', lambda p: read_json(p)["b"], 123456789012345678),
        ("a.b.c = 1\n[d.e]\nf = [1.0, 2.0]\n", read_toml, {"a": {"b": {"c": 1}}, "d": {"e": {"f": [1.0, 2.0]}}}),
        ("a: &x {b: 1}\nc: [*x, *x]\n", read_yaml, {"a": {"b": 1}, "c": [{"b": 1}, {"b": 1}]}),
        ("a: &x {b: 1, c: 1}\nd: {<<: *x, c: 2}\n", lambda p: read_yaml(p)["d"], {"b": 1, "c": 2}),
        ("a: &x 1\nb: &x 2\nc: *x\n", read_yaml, {"a": 1, "b": 2, "c": 2}),
        ("%YAML 1.1\n---\n[on, 08, 1_000, 2026-01-01]\n", read_yaml, ["on", "08", "1_000", "2026-01-01"]),
        ("a,b\r\n1,2\r\n", lambda p: list(read_table(p)[1]), [(2, {"a": "1", "b": "2"})]),
        ("<a><b c='1'/></a>", lambda p: read_xml(p)[0].get("c"), "1"),
    ):  # fmt: skip
        for mark in (b"\xef\xbb\xbf", b""):  # editors of Windows begin UTF-8 with one
            file.write_bytes(mark + text.encode())
            assert read(file) == expected
    assert regular(file).st_size == len("<a><b c='1'/></a>")


def test_what_is_written_is_read_by_us_and_by_readers_of_yaml_1_1(tmp_path: Path) -> None:
    values = {
        "b": [1e-05, 1e20, -0.5, 3, float("inf")],
        "a": {"08": None, "c": "M\u00fcller", "d": ["", True, "1", "no dot"]},
    }
    text = yaml_text(values)
    assert list(yaml.safe_load(text).items()) == list(values.items())
    file = tmp_path / "a.yaml"
    file.write_text(text, encoding="ascii")
    assert read_yaml(file) == values


def test_a_json_of_too_many_values_is_refused_before_it_is_parsed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(documents, "MOST_VALUES", 1000)
    (tmp_path / "a.json").write_text("[" + "[]," * 500 + "1]")
    with pytest.raises(SourceError, match="about 1502 values; at most 1000 are read"):
        read_json(tmp_path / "a.json")
