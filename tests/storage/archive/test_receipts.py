"""Laws of receipts: one is whole or absent, and says what its files must be."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.storage.archive.receipts import (
    Output,
    Receipt,
    ShardFile,
    missing_files,
    receipt_file,
    remove_receipt,
    scan_receipts,
    write_receipt,
)
from posegaussian.storage.archive.store import SequenceGroup
from tests.support.sample_captures import make_sequence

text = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
word = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,7}", fullmatch=True)
maybe = st.none() | st.integers(0, 99)
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | text,
    lambda v: st.lists(v, max_size=3) | st.dictionaries(text, v, max_size=3),
    max_leaves=6,
)
arrays = st.lists(word, min_size=1, max_size=3).map("/".join)
keys = st.tuples(st.sampled_from("./"), st.lists(st.integers(0, 99).map(str), max_size=4)).map(
    lambda key: key[0].join(["c", *key[1]])
) | st.sampled_from(["all.parquet", "p000012.parquet"])


@st.composite
def made_outputs(draw: st.DrawFn) -> Output:
    array = draw(arrays)
    files = [
        ShardFile(f"{array}/{key}", draw(st.integers(0, 2**40)), draw(st.integers(0, 2**32 - 1)))
        for key in draw(st.lists(keys, max_size=3))
    ]
    return Output(array, draw(maybe), draw(text), tuple(files), draw(st.booleans()))


receipts = st.builds(
    Receipt,
    stage=word,
    partition=maybe,
    view=maybe,
    path=st.none() | word,
    fingerprint=text,
    parts=st.dictionaries(text, plain, max_size=3),
    outputs=st.lists(made_outputs(), max_size=3).map(tuple),
    warnings=st.lists(text, max_size=3).map(tuple),
    facts=st.dictionaries(text, plain, max_size=3),
)


@settings(max_examples=50)
@given(receipts)
def test_json_and_back_is_the_identity(receipt: Receipt) -> None:
    assert Receipt.from_json(receipt.to_json()) == receipt


def make_receipt(
    sequence: SequenceGroup,
    stage: str = "depth",
    partition: int | None = 0,
    view: int | None = None,
    path: str | None = None,
    content: bytes = b"12345",
) -> Receipt:
    key = f"{stage}/x/c.{partition or 0}.{view or 0}"
    file = sequence.root / key
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    output = Output(f"{stage}/x", view, "abc", (ShardFile(key, len(content), 7),))
    return Receipt(
        stage, partition, view, path, "f" * 32, {"stage": stage}, (output,), ("a warning",), {"seconds": 1.5}
    )


@pytest.fixture
def sequence(tmp_path: Path) -> SequenceGroup:
    return make_sequence(tmp_path)


KEYS = [
    ("survey", None, 0, None),
    ("frames", 0, 1, None),
    ("frames", 1, 1, None),
    ("depth", 0, None, None),
    ("rendering", 0, None, "orbit-1"),
    ("rendering", 0, None, "still-2"),
]


def test_every_task_has_a_file_of_its_own_and_a_scan_finds_all(sequence: SequenceGroup) -> None:
    made = [make_receipt(sequence, *key) for key in KEYS]
    for r in made:
        write_receipt(sequence, r)
    assert len({receipt_file(sequence, *key) for key in KEYS}) == len(KEYS)
    found = list(scan_receipts(sequence))
    assert sorted(found, key=repr) == sorted(made, key=repr)


def test_removing_takes_one_and_removing_again_is_harmless(sequence: SequenceGroup) -> None:
    for key in KEYS:
        write_receipt(sequence, make_receipt(sequence, *key))
    for _ in range(2):
        remove_receipt(sequence, *KEYS[1])
        assert len(list(scan_receipts(sequence))) == len(KEYS) - 1


def test_a_receipt_cut_at_any_byte_is_ignored(sequence: SequenceGroup) -> None:
    receipt = make_receipt(sequence)
    write_receipt(sequence, receipt)
    whole = make_receipt(sequence, "frames", 0, 1)
    write_receipt(sequence, whole)
    file, data = receipt_file(sequence, "depth", 0, None, None), receipt.to_json()
    for cut in range(0, len(data), 7):
        file.write_bytes(data[:cut])
        assert list(scan_receipts(sequence)) == [whole]
    file.write_bytes(data)
    assert len(list(scan_receipts(sequence))) == 2


@pytest.mark.parametrize(
    "content",
    [
        b"null",
        b"1",
        b'"text"',
        b"[]",
        b"{}",
        b'{"outputs": null}',
        b'{"outputs": [1]}',
        b'{"outputs": [], "warnings": [], "unknown": 1}',
        b"\0" * 100,
        b"\xff\xfe",
        b'{"outputs": {}, "warnings": null}',
    ],
)
def test_what_is_not_a_receipt_is_ignored(sequence: SequenceGroup, content: bytes) -> None:
    whole = make_receipt(sequence)
    write_receipt(sequence, whole)
    other = receipt_file(sequence, "frames", 3, 0, None)
    other.parent.mkdir(parents=True)
    other.write_bytes(content)
    assert list(scan_receipts(sequence)) == [whole]


def test_the_partial_file_of_a_killed_writer_is_ignored(sequence: SequenceGroup) -> None:
    receipt = make_receipt(sequence)
    write_receipt(sequence, receipt)
    file = receipt_file(sequence, "depth", 0, None, None)
    os.replace(file, file.with_name(f".{file.name}.1234.partial"))
    assert list(scan_receipts(sequence)) == []


def test_a_receipt_removed_during_a_scan_is_absent(sequence: SequenceGroup) -> None:
    for p in range(3):
        write_receipt(sequence, make_receipt(sequence, "depth", p))
    scan = scan_receipts(sequence)
    assert next(scan).partition == 0
    remove_receipt(sequence, "depth", 1, None, None)
    assert [r.partition for r in scan] == [2]


def test_missing_files_names_shards_that_are_gone_or_of_another_size(sequence: SequenceGroup) -> None:
    receipt = make_receipt(sequence)
    (f,) = receipt.outputs[0].files
    assert missing_files(sequence, receipt) == []
    for content in (b"", b"1234", b"123456"):
        (sequence.root / f.key).write_bytes(content)
        assert missing_files(sequence, receipt) == [f.key]
    (sequence.root / f.key).unlink()
    assert missing_files(sequence, receipt) == [f.key]
    (sequence.root / f.key).mkdir()
    assert missing_files(sequence, receipt) == [f.key]


def test_a_sequence_without_receipts_has_none(sequence: SequenceGroup) -> None:
    assert list(scan_receipts(sequence)) == []
