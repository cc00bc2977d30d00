"""Checkpoints: bytes kept by step, one file each, whole or not at all, known by their sha256.

A file is one line of JSON (format, step, facts, sha256) and the bytes after it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posegaussian.storage.files.write import PARTIAL, refusals, whole_file
from posegaussian.storage.model.documents import parse_json, read_bytes
from posegaussian.storage.model.errors import NotWritten, SourceError, UserError

FORMAT = 2
SUFFIX = ".checkpoint"
KEPT = 2
"""Checkpoints that stay: should the last one be damaged, the one before it serves."""
LARGEST = 2**32
"""Bytes of a checkpoint that are read: the state of a training of 250 million parameters."""
LONGEST_HEAD = 2**20
"""Bytes of the first line."""


class CheckpointError(UserError):
    """A checkpoint that is damaged or of another format."""


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
    """Keep `data` as `root/STEP.checkpoint`, then remove all but the last two up to this step, and those of later
    steps.

    A later step is one that was found damaged and gone back from. Whatever kills the writer, the file is whole or as it
    was. One process at a time may write to a folder.

    Raises:
        CheckpointError: where the disk does not take it; the ones before are as they were.
    """
    place = _place(root, step)
    body = {"format": FORMAT, "step": step, "facts": dict(facts)}
    head = json.dumps({**body, "sha256": _digest(body, data)}).encode() + b"\n"
    try:
        with refusals(place):
            for left in root.glob(f".*{PARTIAL}"):
                left.unlink()
        with whole_file(place, len(head) + len(data)) as partial, open(partial, "wb") as f:
            f.write(head)
            f.write(data)
    except NotWritten as e:
        raise CheckpointError(
            f"the checkpoint of step {step} is not kept, the ones before are as they were: {e}"
        ) from e
    found = steps_kept(root)
    for other in {*found} - {*[s for s in found if s <= step][:KEPT]}:
        _place(root, other).unlink(missing_ok=True)
    return place


def steps_kept(root: Path) -> list[int]:
    """Steps of the checkpoints that are there, damaged or of an earlier format too, latest first."""
    named = (f for f in root.glob("[0-9]*") if f.suffix == SUFFIX or f.is_dir())
    return sorted({int(f.stem) for f in named if f.stem.isdigit()}, reverse=True)


def read_checkpoint(root: Path, step: int) -> Checkpoint:
    """Read one checkpoint and check all of it. Raises CheckpointError naming the file and what is wrong with it."""
    place = _place(root, step)
    if (pieces := place.with_suffix("")).is_dir():
        raise CheckpointError(
            f"{pieces} is a checkpoint in pieces, which this version does not read; end that training with the version "
            "that began it, or begin a new one in another folder"
        )
    try:
        raw = read_bytes(place, "checkpoint", LARGEST)
        end = raw.find(b"\n", 0, LONGEST_HEAD)
        head = parse_json(raw[: max(end, 0)].decode("utf-8"), place)
        version, said = head["format"], head.pop("sha256")
    except (SourceError, UnicodeDecodeError, KeyError, AttributeError, TypeError) as e:
        raise CheckpointError(f"{place} cannot be read ({e!r})") from e
    if version != FORMAT:
        raise CheckpointError(f"{place} is of format {version!r}; this version reads format {FORMAT}")
    data = raw[end + 1 :]
    if said != (found := _digest(head, data)) or head["step"] != step:
        raise CheckpointError(
            f"{place} has {len(raw)} bytes, sha256 {found[:12]} and step {head.get('step')!r}, expected "
            f"{str(said)[:12]} and {step}"
        )
    return Checkpoint(step, data, head["facts"])


def read_latest(root: Path) -> tuple[Checkpoint | None, list[str]]:
    """The latest checkpoint that is whole, None where there is none at all; and a sentence on each that was passed
    over.

    Raises CheckpointError where there are checkpoints and none is whole: starting anew is for the user to decide.
    """
    damaged: list[str] = []
    for step in steps_kept(root):
        try:
            whole = read_checkpoint(root, step)
        except CheckpointError as e:
            damaged.append(f"the checkpoint of step {step} is damaged: {e}")
            continue
        return whole, [f"{d}; going on from step {step} instead" for d in damaged]
    if damaged:
        advice = "bring one back from a copy, or remove the folder to start anew"
        raise CheckpointError("\n".join([*damaged, f"no checkpoint in {root} is whole; {advice}"]))
    return None, []


def _place(root: Path, step: int) -> Path:
    return root / f"{step:08d}{SUFFIX}"


def _digest(body: Mapping[str, Any], data: bytes) -> str:
    """Of all that a checkpoint holds."""
    digest = hashlib.sha256(json.dumps(body, sort_keys=True).encode())
    digest.update(data)
    return digest.hexdigest()
