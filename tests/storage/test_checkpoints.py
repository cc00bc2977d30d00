"""Checkpoints: whole or refused, in pieces, the last two kept."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

from posegaussian.storage.archive import checkpoints
from posegaussian.storage.archive.checkpoints import (
    PIECE_BYTES,
    CheckpointError,
    read_checkpoint,
    read_latest,
    steps_kept,
    write_checkpoint,
)
from posegaussian.storage.files import write


@pytest.mark.parametrize("length", [0, 1, PIECE_BYTES, PIECE_BYTES + 1, 2 * PIECE_BYTES + 12_345])
def test_what_is_written_is_read_and_no_piece_is_larger_than_15_megabytes(tmp_path: Path, length: int) -> None:
    data = os.urandom(1000) * (length // 1000 + 1)
    place = write_checkpoint(tmp_path, 7, data[:length], {"minutes": 1.5})
    sizes = [f.stat().st_size for f in place.glob("*.bin")]
    assert max(sizes) <= 15_000_000
    assert len(sizes) == max(1, -(-length // PIECE_BYTES))
    checkpoint, said = read_latest(tmp_path)
    assert checkpoint is not None
    assert (checkpoint.step, checkpoint.data, checkpoint.facts, said) == (7, data[:length], {"minutes": 1.5}, [])


def test_the_last_two_are_kept(tmp_path: Path) -> None:
    for step in (5, 10, 15, 120):
        write_checkpoint(tmp_path, step, b"x", {})
    assert steps_kept(tmp_path) == [120, 15]


def break_piece(place: Path) -> None:
    file = place / "0001.bin"
    data = bytearray(file.read_bytes())
    data[2] ^= 1
    file.write_bytes(data)


def shorten(place: Path) -> None:
    os.truncate(place / "0000.bin", 2)


def lose_piece(place: Path) -> None:
    (place / "0001.bin").unlink()


def lose_manifest(place: Path) -> None:
    (place / "manifest.json").unlink()


def alter_manifest(place: Path) -> None:
    manifest = json.loads((place / "manifest.json").read_bytes())
    manifest["pieces"].pop()
    (place / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize("spoil", [break_piece, shorten, lose_piece, lose_manifest, alter_manifest])
def test_a_damaged_one_is_refused_and_the_one_before_it_serves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spoil
) -> None:
    monkeypatch.setattr(checkpoints, "PIECE_BYTES", 4)
    write_checkpoint(tmp_path, 10, b"before", {})
    place = write_checkpoint(tmp_path, 20, b"damaged", {})
    spoil(place)
    with pytest.raises(CheckpointError, match="00000020"):
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
    lose_manifest(write_checkpoint(tmp_path, 10, b"x", {}))
    with pytest.raises(CheckpointError, match=r"no checkpoint in .* is whole"):
        read_latest(tmp_path)


def test_a_writer_that_died_leaves_the_ones_before_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_checkpoint(tmp_path, 10, b"whole", {})

    def dies(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as m:
        m.setattr(checkpoints.os, "rename", dies)
        with pytest.raises(KeyboardInterrupt):
            write_checkpoint(tmp_path, 20, b"half", {})
    checkpoint, _ = read_latest(tmp_path)
    assert checkpoint is not None
    assert checkpoint.step == 10
    write_checkpoint(tmp_path, 20, b"whole", {})
    assert sorted(f.name for f in tmp_path.iterdir()) == ["00000010", "00000020"]


def test_a_full_disk_is_a_sentence_and_costs_nothing_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_checkpoint(tmp_path, 10, b"whole", {})

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as m:
        m.setattr(write.os, "fsync", full)
        with pytest.raises(
            CheckpointError,
            match=(
                r"step 20 is not kept, the ones before are as they were: cannot write .* the disk is full: .* are free"
            ),
        ):
            write_checkpoint(tmp_path, 20, b"more", {})
    assert [f.name for f in tmp_path.iterdir()] == ["00000010"]
    assert read_checkpoint(tmp_path, 10).data == b"whole"


def test_an_empty_folder_has_none(tmp_path: Path) -> None:
    assert read_latest(tmp_path / "nothing") == (None, [])
