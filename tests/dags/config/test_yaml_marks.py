"""Every key and item knows its place; what YAML cannot read becomes a sentence with one."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.dags.config.yaml_source import Document, load, parse_value
from posegaussian.storage.model.errors import ConfigError


def document(folder: Path, text: str) -> Document:
    file = folder / "c.yaml"
    file.write_text(text, encoding="utf-8")
    return load(file)


def fault(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as error:
        document(folder, text)
    return str(error.value).replace(str(folder) + "/", "")


keys = st.text("abcxyz_", min_size=1, max_size=5).filter(lambda k: yaml.safe_load(k) == k)
values = st.recursive(
    st.none() | st.booleans() | st.integers(-99, 99) | st.floats(-9, 9) | keys,
    lambda v: st.lists(v, max_size=3) | st.dictionaries(keys, v, max_size=3),
    max_leaves=8,
)


@settings(max_examples=50)
@given(st.dictionaries(keys, values, max_size=4), st.sampled_from([True, False, None]))
def test_values_are_those_of_a_plain_yaml_reader(
    tmp_path_factory: pytest.TempPathFactory, value: dict, flow: bool | None
) -> None:
    text = yaml.safe_dump(value, default_flow_style=flow)
    read = document(tmp_path_factory.getbasetemp(), text)
    assert read.values == yaml.safe_load(text)
    lines = text.splitlines()
    for location, (line, column) in read.marks.items():
        if isinstance(location[-1], str):
            assert lines[line - 1][column - 1 :].lstrip("?'\" ").startswith(location[-1]), location


TEXT = """\
depth:
  method: hull
  # a comment
  pairs: 3
views: {sources: [a, b]}
"""


def test_marks_are_line_and_column_from_one(tmp_path: Path) -> None:
    d = document(tmp_path, TEXT)
    assert d.values == {"depth": {"method": "hull", "pairs": 3}, "views": {"sources": ["a", "b"]}}
    at = {
        ("depth",): "1:1",
        ("depth", "method"): "2:3",
        ("depth", "pairs"): "4:3",
        ("views", "sources"): "5:9",
        ("views", "sources", 1): "5:22",
    }
    for location, place in at.items():
        assert d.where(location) == f"{tmp_path}/c.yaml:{place}"


def test_the_nearest_key_around_stands_in_for_one_that_has_no_place(tmp_path: Path) -> None:
    d = document(tmp_path, TEXT)
    assert d.where(("depth", "method", "x", 3)) == d.where(("depth", "method"))
    assert d.where(("depth", "unknown")) == d.where(("depth",))
    assert d.where(("unknown",)) == d.source
    assert Document("--set").where(("depth", "method")) == "--set"


def test_an_empty_file_says_nothing(tmp_path: Path) -> None:
    assert document(tmp_path, "").values == {}
    assert document(tmp_path, "# only a comment\n").values == {}


def test_keys_are_texts_whatever_yaml_takes_them_for(tmp_path: Path) -> None:
    assert document(tmp_path, "sequences: {01: {a: 1}, on: {a: 2}, null: {a: 3}}").values["sequences"].keys() == {
        "01",
        "on",
        "null",
    }


def test_keys_given_twice_are_all_named_with_both_places(tmp_path: Path) -> None:
    text = "a: 1\nb: {c: 1, c: 2}\na: 3\n"
    assert (
        fault(tmp_path, text)
        == "c.yaml:2:11 b.c: given twice, first at c.yaml:2:5\nc.yaml:3:1 a: given twice, first at c.yaml:1:1"
    )


BROKEN = {
    "depth: [1\n": "c.yaml:2:1: not valid YAML",
    "\tdepth: 1": "c.yaml:1:1: not valid YAML",
    "depth:\n  method: hull\n pairs: 3\n": "c.yaml:3:2: not valid YAML",
    "a: &x 1\nb: *y\n": "c.yaml:2:4: not valid YAML",
    "a: \0": "c.yaml: not valid YAML",
    "- a\n": "c.yaml:1:1: a configuration is a mapping",
    "5": "c.yaml:1:1: a configuration is a mapping",
    "depth: {method: !foo bar}\n": "c.yaml:1:17 depth.method: cannot read 'bar'",
    "depth:\n  [a, b]: 1\n": "c.yaml:2:3 a key must be a word",
    "{{ x }}: 1\n": "c.yaml:1:1 a key must be a word",
    "a: &x {b: *x}\n": "c.yaml:1:11: not valid YAML: the alias *x holds itself",
}


@pytest.mark.parametrize("text", BROKEN)
def test_what_yaml_cannot_read_is_a_sentence_with_its_place(tmp_path: Path, text: str) -> None:
    assert fault(tmp_path, text).startswith(BROKEN[text])


def test_several_faults_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    assert len(fault(tmp_path, "a: 1\na: 2\nb: !foo 1\nc: !bar 2\n").splitlines()) == 3


def test_a_missing_or_unreadable_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot read configuration .*none\.yaml"):
        load(tmp_path / "none.yaml")
    (tmp_path / "latin.yaml").write_bytes("archive: M\xfcller".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"cannot read configuration .*latin\.yaml"):
        load(tmp_path / "latin.yaml")


@pytest.mark.parametrize("text", ["[1", "{a: 1, a: 2}", "!foo 1", "9" * 30, "\0", "*a", "[" * 5000])
def test_what_is_no_value_is_one_line(text: str) -> None:
    with pytest.raises(ConfigError, match="is not a YAML value: ") as error:
        parse_value(text)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1:9:3", "1:9:3"),
        ("3:1", "3:1"),
        ("on", "on"),
        ("no", "no"),
        ("2026-01-01", "2026-01-01"),
        ("08", "08"),
        ("1e-3", 1e-3),
        ("-2", -2),
        (".5", 0.5),
        ("true", True),
        ("null", None),
        ("[1, 2.0]", [1, 2.0]),
    ],
)
def test_plain_values_are_those_of_yaml_1_2(text: str, value: object) -> None:
    found = parse_value(text)
    assert found == value
    assert type(found) is type(value)
