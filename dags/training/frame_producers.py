"""Frames of a training: made ahead of the trainer by processes of their own,
kept as files, read when their time comes."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import time
import traceback
import zipfile
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from posegaussian.dags.runtime.threads import allocator, limit
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.files.write import make_folder, whole_file, write_atomically
from posegaussian.storage.model.errors import NotWritten, UserError

if TYPE_CHECKING:
    from multiprocessing.context import SpawnProcess

    from posegaussian.stages.training.contract import Frame

DEATHS = 2
"""Processes that may die over one frame before it is given up."""
POLL_S = 0.2
"""Pause between two looks at whether the training is to stop while it waits for frames, seconds."""
QUIET_SECONDS = 20.0
"""Pause between two lines that say what is waited for."""
LEFT_S = 3600.0
"""Age at which a half-written file is taken for what a kill left behind;
another training may be writing a younger one."""


class FrameError(UserError):
    """A frame that cannot be made."""


@dataclass(frozen=True)
class QueuedFrame:
    """One frame."""

    kind: str
    """training or validation."""
    index: int
    """Within its kind."""
    seed: int
    """Of its scene."""
    moment: int
    """Within its scene."""

    @classmethod
    def training(cls, config: TrainingConfig, index: int) -> QueuedFrame:
        """A frame that steps draw from."""
        return cls("training", index, config.scene_seed(index), index % config.frames_per_scene)

    @classmethod
    def validation(cls, config: TrainingConfig, index: int) -> QueuedFrame:
        """A frame that weights are measured on."""
        return cls("validation", index, config.validation_seed(index), 0)

    @property
    def file(self) -> str:
        """Its name within the folder of its key: what it shows, so that a moment that comes round again is one file."""
        return f"{self.seed:04d}-{self.moment:02d}.npz"

    def __str__(self) -> str:
        return f"{self.kind} frame {self.index} (scene seed {self.seed}, moment {self.moment})"


class Producers:
    """Processes that make frames into files, in the order in which they were asked for;
    with none, they are made here."""

    def __init__(self, config: TrainingConfig, folder: Path, frames: str, count: int) -> None:
        """`folder` holds the files of this data key; `frames` is the module that makes frames."""
        self.config, self.folder, self.source, self.count = config, folder, frames, count
        self.queue: deque[QueuedFrame] = deque()
        self.busy: dict[Connection, tuple[SpawnProcess, QueuedFrame | None]] = {}
        self.deaths: Counter[QueuedFrame] = Counter()
        self.made = 0
        """Frames made so far."""
        make_folder(folder)
        for left in folder.glob(".*.partial"):
            with contextlib.suppress(FileNotFoundError):  # another training may sweep as well
                if time.time() - left.stat().st_mtime > LEFT_S:
                    left.unlink()

    def has(self, item: QueuedFrame) -> bool:
        """Whether its file is there."""
        return (self.folder / item.file).is_file()

    def order(self, items: Iterable[QueuedFrame], first: bool = False) -> None:
        """Ask for frames; those that are there or asked for already are not asked for twice.
        `first`: before all others."""
        under_way = {i.file for _, i in self.busy.values() if i is not None}
        wanted = {i.file: i for i in items if i.file not in under_way and not self.has(i)}
        queued = {i.file: i for i in self.queue}
        self.queue = deque(({**wanted, **queued} if first else {**queued, **wanted}).values())

    def poll(self, seconds: float) -> None:
        """Hand out work, and wait for a frame at most `seconds`. Raises FrameError for one that cannot be made."""
        if self.count == 0:
            if item := self._next():
                self._done(item, _made(self.config, self.folder, self.source, item))
            return
        working = sum(item is not None for _, item in self.busy.values())
        while len(self.busy) < min(self.count, working + len(self.queue)):
            self._start()
        for connection, (process, item) in list(self.busy.items()):
            if item is None and (following := self._next()):
                self._send(connection, process, following)
        waiting = [c for c, (_, item) in self.busy.items() if item is not None]
        for connection in cast(list[Connection], wait(waiting, seconds) if waiting else []):
            process, item = self.busy[connection]
            assert item is not None
            try:
                failure = connection.recv()
            except (EOFError, OSError):
                self._died(connection, item)
                continue
            self.busy[connection] = (process, None)
            self._done(item, failure)

    def kill(self) -> None:
        """End the processes without waiting for them; any thread may do so."""
        for process, _ in list(self.busy.values()):
            process.kill()

    def close(self) -> None:
        """End the processes; frames half made are lost, files are whole or not there."""
        for connection, (process, _) in self.busy.items():
            process.kill()
            process.join()
            connection.close()
        self.busy.clear()

    def _next(self) -> QueuedFrame | None:
        while self.queue:
            item = self.queue.popleft()
            if not self.has(item):  # another training with the same data may have made it meanwhile
                return item
        return None

    def _start(self) -> None:
        context = get_context("spawn")  # torch runs threads here: a fork could not be trusted
        os.environ.update(allocator())
        ours, theirs = context.Pipe()
        process = context.Process(
            target=_produce, args=(theirs, self.config, self.folder, self.source), name="frames", daemon=True
        )
        process.start()
        theirs.close()
        self.busy[ours] = (process, None)

    def _send(self, connection: Connection, process: SpawnProcess, item: QueuedFrame) -> None:
        try:
            connection.send(item)
            self.busy[connection] = (process, item)
        except OSError:
            self._died(connection, item)

    def _died(self, connection: Connection, item: QueuedFrame) -> None:
        process, _ = self.busy.pop(connection)
        process.join()
        connection.close()
        self.deaths[item] += 1
        if self.deaths[item] >= DEATHS:
            memory = process.exitcode == -signal.SIGKILL
            why = (
                f"killed, most likely as memory ran out: use fewer than {self.count} --workers"
                if memory
                else f"exit status {process.exitcode}; what it said stands above"
            )
            raise FrameError(f"{item} cannot be made: {DEATHS} processes died over it, the last one {why}")
        self.queue.appendleft(item)

    def _done(self, item: QueuedFrame, failure: tuple[str, str] | None) -> None:
        if failure is None:
            self.made += 1
            return
        why, trace = failure
        file = self.folder / f"{item.file}.failed.txt"
        if not trace:
            raise FrameError(f"{item} cannot be made: {why}")
        write_atomically(file, trace.encode())
        raise FrameError(
            f"{item} cannot be made: {why}; where it happened is in {file}. Leave that scene out with scenes.first and"
            " scenes.count, or mend its cause"
        )


class ProducedFrames:
    """The sliding window of frames at hand, and what is made ahead of it."""

    def __init__(
        self, config: TrainingConfig, producers: Producers, range_of: Callable[[int], range], say: Callable[[str], None]
    ) -> None:
        """`range_of` tells the training frames of a step."""
        self.config, self.producers, self.range_of, self.say = config, producers, range_of, say
        self.limit = max(4, 2 * producers.count)
        """Frames asked for beyond those of the current step, at most."""
        self.held: dict[int, Frame] = {}
        self._scanned = 0
        self._asked: set[int] = set()

    @property
    def ahead(self) -> int:
        """Frames there beyond those in hand."""
        return sum(self.producers.has(QueuedFrame.training(self.config, i)) for i in self._asked if i not in self.held)

    def of_step(self, step: int, go_on: Callable[[], bool]) -> dict[int, Frame] | None:
        """The training frames of a step; None where `go_on` says no while they are waited for."""
        needed = self.range_of(step)
        self.held = {i: f for i, f in self.held.items() if i in needed}
        missing = [i for i in needed if i not in self.held]
        if missing:
            self.producers.order((QueuedFrame.training(self.config, i) for i in missing), first=True)
        if self.producers.count:
            self._ask_ahead(step, needed)
        if missing:
            found = self._read([QueuedFrame.training(self.config, i) for i in missing], go_on)
            if found is None:
                return None
            self.held.update({item.index: frame for item, frame in found.items()})
        elif self.producers.count:
            self.producers.poll(0.0)
        return {i: self.held[i] for i in needed}

    def of_validation(self, go_on: Callable[[], bool]) -> dict[int, Frame] | None:
        """All validation frames; None where `go_on` says no while they are waited for."""
        items = self._validation_items()
        self.producers.order(items, first=True)
        found = self._read(items, go_on)
        return None if found is None else {item.index: frame for item, frame in found.items()}

    def _validation_items(self) -> list[QueuedFrame]:
        return [QueuedFrame.validation(self.config, i) for i in range(self.config.validation.count)]

    def _ask_ahead(self, step: int, needed: range) -> None:
        """Ask for frames of later steps, and at the first step for those of validation too,
        so that nobody waits for them then."""
        first = self._scanned == 0
        self._scanned = max(self._scanned, step + 1)
        self._asked = {i for i in self._asked if i >= needed.start and i not in needed}
        while len(self._asked) < self.limit and self._scanned < self.config.steps:
            new = [i for i in self.range_of(self._scanned) if i not in needed and i not in self._asked]
            self._asked.update(new)
            self.producers.order(QueuedFrame.training(self.config, i) for i in new)
            self._scanned += 1
        if first:
            self.producers.order(self._validation_items())

    def _read(self, items: list[QueuedFrame], go_on: Callable[[], bool]) -> dict[QueuedFrame, Frame] | None:
        found: dict[QueuedFrame, Frame] = {}
        said = time.monotonic()
        while left := [i for i in items if i not in found]:
            there = [i for i in left if self.producers.has(i)]
            for item in there:
                file = self.producers.folder / item.file
                try:
                    found[item] = read_frame(file)
                except (zipfile.BadZipFile, ValueError, EOFError, OSError, KeyError) as e:
                    self.say(f"{file} is damaged ({e}); it is made again")
                    file.unlink(missing_ok=True)
                    self.producers.order([item], first=True)
            if not there:
                if not go_on():
                    return None
                if time.monotonic() - said > QUIET_SECONDS:
                    self.say(f"waiting for frames: {len(found)} of {len(items)} are there")
                    said = time.monotonic()
                self.producers.poll(POLL_S)
        return {i: found[i] for i in items}


def read_frame(file: Path) -> Frame:
    """The arrays of a file, with their checksums compared."""
    with np.load(file, allow_pickle=False) as f:
        return {name: f[name] for name in f.files}


def _made(config: TrainingConfig, folder: Path, frames: str, item: QueuedFrame) -> tuple[str, str] | None:
    """Make one frame into its file; (sentence, traceback) where that fails,
    without a traceback for what the user can mend."""
    try:
        module = importlib.import_module(frames)
        make = module.make_frame if item.kind == "training" else module.validation_frame
        frame = make(config, item.index)
        with whole_file(folder / item.file, sum(a.nbytes for a in frame.values())) as partial, open(partial, "wb") as f:
            np.savez(f, allow_pickle=False, **frame)
    except NotWritten as e:
        return str(e), ""
    except Exception as e:
        return f"{type(e).__name__}: {e}", traceback.format_exc()
    return None


def _produce(connection: Connection, config: TrainingConfig, folder: Path, frames: str) -> None:
    """The life of a process: one frame after another until the training is gone."""
    # a terminal sends it here too; the training alone decides what it means
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit(1)
    try:
        while True:
            connection.send(_made(config, folder, frames, connection.recv()))
    except (EOFError, OSError):
        return
