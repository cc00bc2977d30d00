"""Checkpoints: whole or refused, one file each, the last two kept."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from posegaussian.storage.archive.checkpoints import (
    CheckpointError,
    read_checkpoint,
    read_latest,
    steps_kept,
    write_checkpoint,
)
from posegaussian.storage.files import write


@pytest.mark.parametrize("length", [0, 1, 30_012_345])
def test_what_is_written_is_read_from_one_file(tmp_path: Path, length: int) -> None:
    data = (os.urandom(1000) * (length // 1000 + 1))[:length]
    place = write_checkpoint(tmp_path, 7, data, {"minutes": 1.5})
    assert list(tmp_path.iterdir()) == [place]
    assert place.name == "00000007.checkpoint"
    checkpoint, said = read_latest(tmp_path)
    assert checkpoint is not None
    assert (checkpoint.step, checkpoint.data, checkpoint.facts, said) == (7, data, {"minutes": 1.5}, [])


def test_the_last_two_are_kept(tmp_path: Path) -> None:
    for step in (5, 10, 15, 120):
        write_checkpoint(tmp_path, step, b"x", {})
    assert steps_kept(tmp_path) == [120, 15]
    assert sorted(f.name for f in tmp_path.iterdir()) == ["00000015.checkpoint", "00000120.checkpoint"]


def alter_data(place: Path) -> None:
    raw = bytearray(place.read_bytes())
    raw[-2] ^= 1
    place.write_bytes(raw)


def shorten(place: Path) -> None:
    os.truncate(place, place.stat().st_size - 1)


def lengthen(place: Path) -> None:
    place.write_bytes(place.read_bytes() + b"d")


def empty(place: Path) -> None:
    place.write_bytes(b"")


def lose_head(place: Path) -> None:
    place.write_bytes(place.read_bytes().partition(b"\n")[2])


def alter_facts(place: Path) -> None:
    place.write_bytes(place.read_bytes().replace(b'"minutes": 2', b'"minutes": 1', 1))


def take_another_step(place: Path) -> None:
    place.write_bytes(place.with_name("00000010.checkpoint").read_bytes())


@pytest.mark.parametrize("spoil", [alter_data, shorten, lengthen, empty, lose_head, alter_facts, take_another_step])
def test_a_damaged_one_is_refused_and_the_one_before_it_serves(tmp_path: Path, spoil) -> None:
    write_checkpoint(tmp_path, 10, b"before", {"minutes": 2})
    spoil(write_checkpoint(tmp_path, 20, b"damaged", {"minutes": 2}))
    with pytest.raises(CheckpointError, match=r"00000020\.checkpoint"):
        read_checkpoint(tmp_path, 20)
    checkpoint, said = read_latest(tmp_path)
    assert checkpoint is not None
    assert (checkpoint.step, checkpoint.data) == (10, b"before")
    assert len(said) == 1
    assert "step 20 is damaged" in said[0]
    assert "going on from step 10" in said[0]
    write_checkpoint(tmp_path, 15, b"again", {})
    assert steps_kept(tmp_path) == [15, 10], "the damaged one is of a later step and goes"


def test_where_all_are_damaged_nothing_starts_anew_by_itself(tmp_path: Path) -> None:
    shorten(write_checkpoint(tmp_path, 10, b"x", {}))
    with pytest.raises(CheckpointError, match=r"no checkpoint in .* is whole"):
        read_latest(tmp_path)


def test_one_of_a_later_format_is_named(tmp_path: Path) -> None:
    (tmp_path / "00000010.checkpoint").write_bytes(b'{"format": 3, "sha256": ""}\n')
    with pytest.raises(CheckpointError, match="is of format 3; this version reads format 2"):
        read_checkpoint(tmp_path, 10)


def test_a_folder_of_pieces_is_refused_with_what_to_do_and_stays(tmp_path: Path) -> None:
    """That is how checkpoints were kept before they became files."""
    pieces = tmp_path / "00000010"
    pieces.mkdir()
    (pieces / "manifest.json").write_text("{}")
    assert steps_kept(tmp_path) == [10], "a training in this folder does not begin anew"
    with pytest.raises(
        CheckpointError, match=r"00000010 is a checkpoint in pieces.* end that training with the version"
    ):
        read_latest(tmp_path)
    assert (pieces / "manifest.json").is_file()


def test_a_writer_that_died_leaves_the_ones_before_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_checkpoint(tmp_path, 10, b"whole", {})

    def dies(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as m:
        m.setattr(write.os, "replace", dies)
        with pytest.raises(KeyboardInterrupt):
            write_checkpoint(tmp_path, 20, b"half", {})
    checkpoint, _ = read_latest(tmp_path)
    assert checkpoint is not None
    assert checkpoint.step == 10
    (tmp_path / ".00000020.checkpoint.1.0.partial").write_bytes(b"what a kill leaves")
    write_checkpoint(tmp_path, 20, b"whole", {})
    assert sorted(f.name for f in tmp_path.iterdir()) == ["00000010.checkpoint", "00000020.checkpoint"]


def test_a_full_disk_is_a_sentence_and_costs_nothing_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_checkpoint(tmp_path, 10, b"whole", {})

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as m:
        m.setattr(write.os, "fsync", full)
        sentence = (
            r"step 20 is not kept, the ones before are as they were: cannot write .* the disk is full: .* are free"
        )
        with pytest.raises(CheckpointError, match=sentence):
            write_checkpoint(tmp_path, 20, b"more", {})
    assert [f.name for f in tmp_path.iterdir()] == ["00000010.checkpoint"]
    assert read_checkpoint(tmp_path, 10).data == b"whole"


def test_an_empty_folder_has_none(tmp_path: Path) -> None:
    assert read_latest(tmp_path / "nothing") == (None, [])
