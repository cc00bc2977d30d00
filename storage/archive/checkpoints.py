"""Checkpoints: bytes kept by step, in pieces small enough for any store, whole or not at all, known by their sha256."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posegaussian.storage.files.write import PARTIAL, refusals, sync_folder, write_atomically
from posegaussian.storage.model.documents import read_bytes, read_json
from posegaussian.storage.model.errors import NotWritten, SourceError, UserError

FORMAT = 1
PIECE_BYTES = 15_000_000
"""Largest piece: hosts of repositories and mail refuse much larger files."""
KEPT = 2
"""Checkpoints that stay: should the last one be damaged, the one before it serves."""
MANIFEST = "manifest.json"


class CheckpointError(UserError):
    """A checkpoint that is damaged, incomplete or of a newer format."""


@dataclass(frozen=True)
class Checkpoint:
    """What was kept at one step."""

    step: int
    """Steps done."""
    data: bytes
    """As it was given."""
    facts: dict[str, Any]
    """Circumstances, as they were given; not part of the data."""


def write_checkpoint(root: Path, step: int, data: bytes, facts: Mapping[str, Any]) -> Path:
    """Keep `data` as `root/STEP/`, then remove all but the last two up to this step, and those of later steps.

    A later step is one that was found damaged and gone back from. Whatever kills the writer, `root/STEP` is whole or as
    it was.

    Raises:
        CheckpointError: where the disk does not take it; the ones before are as they were.
    """
    partial = root / f".{step:08d}{PARTIAL}"
    try:
        with refusals(root / f"{step:08d}", len(data)):
            return _write_checkpoint(root, partial, step, data, facts)
    except NotWritten as e:
        shutil.rmtree(partial, ignore_errors=True)
        raise CheckpointError(
            f"the checkpoint of step {step} is not kept, the ones before are as they were: {e}"
        ) from e


def _write_checkpoint(root: Path, partial: Path, step: int, data: bytes, facts: Mapping[str, Any]) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    for left in root.glob(f".*{PARTIAL}"):
        shutil.rmtree(left)
    partial.mkdir()
    pieces = []
    for n, start in enumerate(range(0, max(1, len(data)), PIECE_BYTES)):
        piece = memoryview(data)[start : start + PIECE_BYTES]
        name = f"{n:04d}.bin"
        write_atomically(partial / name, piece)
        pieces.append({"name": name, "bytes": len(piece), "sha256": hashlib.sha256(piece).hexdigest()})
    body = {"format": FORMAT, "step": step, "bytes": len(data), "pieces": pieces, "facts": dict(facts)}
    write_atomically(partial / MANIFEST, json.dumps({**body, "sha256": _digest(body)}, indent=1).encode())
    sync_folder(partial)
    place = root / f"{step:08d}"
    if place.exists():
        shutil.rmtree(place)
    os.rename(partial, place)
    sync_folder(root)
    found = steps_kept(root)
    for other in {*found} - {*[s for s in found if s <= step][:KEPT]}:
        shutil.rmtree(root / f"{other:08d}")
    return place


def steps_kept(root: Path) -> list[int]:
    """Steps of the checkpoints that are there, damaged or not, latest first."""
    return sorted((int(f.name) for f in root.glob("[0-9]*") if f.is_dir() and f.name.isdigit()), reverse=True)


def read_checkpoint(root: Path, step: int) -> Checkpoint:
    """Read one checkpoint and check all of it. Raises CheckpointError naming the file and what is wrong with it."""
    place = root / f"{step:08d}"
    try:
        manifest = read_json(place / MANIFEST, "manifest")
        said = manifest.pop("sha256")
        version = manifest["format"]
    except (SourceError, KeyError, AttributeError, TypeError) as e:
        raise CheckpointError(f"{place / MANIFEST} cannot be read ({e!r})") from e
    if version != FORMAT:
        raise CheckpointError(f"{place / MANIFEST} is of format {version}; this version reads format {FORMAT}")
    if said != (found := _digest(manifest)) or manifest["step"] != step:
        raise CheckpointError(
            f"{place / MANIFEST} has sha256 {found[:12]} and step {manifest.get('step')}, expected {str(said)[:12]} and"
            f" {step}"
        )
    parts = []
    for piece in manifest["pieces"]:
        file = place / piece["name"]
        try:
            part = read_bytes(file, "piece of a checkpoint", PIECE_BYTES)
        except SourceError as e:
            raise CheckpointError(str(e)) from e
        if (found := hashlib.sha256(part).hexdigest()) != piece["sha256"]:
            raise CheckpointError(
                f"{file} has {len(part)} bytes and sha256 {found[:12]}, expected {piece['bytes']} and"
                f" {piece['sha256'][:12]}"
            )
        parts.append(part)
    return Checkpoint(step, b"".join(parts), manifest["facts"])


def read_latest(root: Path) -> tuple[Checkpoint | None, list[str]]:
    """The latest checkpoint that is whole, None where there is none at all; and a sentence on each damaged one that was
    passed over.

    Raises CheckpointError where there are checkpoints and none is whole: starting anew is for the user to decide.
    """
    damaged: list[str] = []
    found = steps_kept(root)
    for step in found:
        try:
            whole = read_checkpoint(root, step)
        except CheckpointError as e:
            damaged.append(f"the checkpoint of step {step} is damaged: {e}")
            continue
        return whole, [f"{d}; going on from step {step} instead" for d in damaged]
    if damaged:
        raise CheckpointError(
            "\n".join(
                [
                    *damaged,
                    f"no checkpoint in {root} is whole; bring one back from a copy, or remove the folder to start anew",
                ]
            )
        )
    return None, []


def _digest(body: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()
