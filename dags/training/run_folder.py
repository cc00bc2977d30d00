"""The folder of a training: its configuration, log, checkpoints, frames, weights and picture;
one training at a time."""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from posegaussian.dags.config.yaml_source import load
from posegaussian.dags.training.config import CHECKPOINTS, differences, forbidden
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.archive.checkpoints import Checkpoint, read_latest, steps_kept, write_checkpoint
from posegaussian.storage.files.write import refusals, write_atomically
from posegaussian.storage.model.errors import ConfigError, UserError
from posegaussian.storage.model.yaml_documents import yaml_text


@contextlib.contextmanager
def locked(file: Path, held: str) -> Iterator[None]:
    """Within, this process alone holds a file, which is made; a kill frees it. Raises UserError with the sentence
    `held` where another one does."""
    with refusals(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle = file.open("w")
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(held) from None
        yield


class RunFolder:
    """Everything a training leaves behind, and all that the next one needs to go on."""

    def __init__(self, root: Path) -> None:
        """Nothing is written yet."""
        self.root = root
        self.config_file = root / "config.yaml"
        self.log_file = root / "log.jsonl"
        self.checkpoints = root / CHECKPOINTS
        self.weights_file = root / "weights.safetensors"
        self.picture_file = root / "training.png"
        self.rows: list[dict[str, Any]] = []
        """The log so far."""
        self._log: IO[str] | None = None

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Within, this process alone trains here; a kill frees the folder. Raises UserError where another one does, and
        NotWritten where the log's last rows cannot be written."""
        with locked(
            self.root / ".lock", f"another training is running in {self.root}; wait for it or choose another --output"
        ):
            try:
                yield
            finally:
                if self._log:
                    with refusals(self.log_file):  # a row that a full disk did not take is tried once more
                        self._log.close()
                    self._log = None

    def take(self, config: TrainingConfig) -> list[str]:
        """Note the effective configuration; sentences on what differs from that of the training that goes on.

        Raises ConfigError where something differs with which it cannot go on.
        """
        new = config.model_dump(mode="json")
        said = []
        if kept := steps_kept(self.checkpoints):
            if not self.config_file.is_file():
                raise ConfigError(
                    f"{self.root} holds checkpoints and no config.yaml; bring it back, or choose another --output"
                )
            changes = differences(load(self.config_file).values, new)
            if wrong := forbidden(changes):
                told = "; ".join(f"{key}: {change}" for key, change in wrong.items())
                raise ConfigError(
                    f"{self.root} holds a training at step {kept[0]} with another configuration ({told}); choose"
                    " another --output for the new one, or take these back to go on"
                )
            said = [f"{key}: {change}, from here on" for key, change in changes.items()]
        write_atomically(self.config_file, yaml_text(new).encode())
        return said

    def resume(self) -> tuple[Checkpoint | None, list[str]]:
        """The checkpoint to go on from, with sentences; the log is cut to its step and opened.

        Raises CheckpointError where checkpoints are there and none is whole.
        """
        checkpoint, said = read_latest(self.checkpoints)
        step = checkpoint.step if checkpoint else 0
        self.rows = [row for row in read_rows(self.log_file) if row["step"] <= step]
        write_atomically(self.log_file, "".join(_line(row) for row in self.rows).encode())
        self._log = self.log_file.open("a", encoding="utf-8")
        return checkpoint, said

    def note(self, row: Mapping[str, Any]) -> None:
        """Append a row."""
        assert self._log is not None, "the log is open after resume()"
        self.rows.append(dict(row))
        with refusals(self.log_file):
            self._log.write(_line(row))
            self._log.flush()

    @property
    def skipped(self) -> int:
        """Steps so far whose loss or gradient was not finite, and which changed no weight."""
        return skipped(self.rows)

    def validated_at(self, step: int) -> bool:
        """Whether the log has a validation of this step."""
        return any(row["kind"] == "validation" and row["step"] == step for row in reversed(self.rows[-3:]))

    def keep(self, step: int, data: bytes, facts: Mapping[str, Any]) -> None:
        """Write a checkpoint; the log up to it is on disk before it is."""
        assert self._log is not None, "the log is open after resume()"
        with refusals(self.log_file):
            os.fsync(self._log.fileno())
        write_checkpoint(self.checkpoints, step, data, facts)


def log_row(kind: str, step: int, numbers: Mapping[str, Any]) -> dict[str, Any]:
    """A row of the log, of kind `step` or `validation`, after so many steps; what is not finite becomes null."""
    plain = {k: v if isinstance(v, str | int | None) else float(v) for k, v in numbers.items()}
    return {
        "kind": kind,
        "step": step,
        **{k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in plain.items()},
    }


def skipped(rows: Sequence[Mapping[str, Any]]) -> int:
    """How many of the steps in the rows of a log changed no weight, as the last of them says."""
    return int(next((r.get("skipped") or 0 for r in reversed(rows) if r["kind"] == "step"), 0))


def _line(row: Mapping[str, Any]) -> str:
    return json.dumps(row, allow_nan=False) + "\n"


def read_rows(file: Path) -> list[dict[str, Any]]:
    """Rows of a log; what a kill left half written at its end is dropped."""
    rows = []
    if file.is_file():
        for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                row = json.loads(line)
            except ValueError:
                break
            if not isinstance(row, dict) or "step" not in row or "kind" not in row:
                break
            rows.append(row)
    return rows
