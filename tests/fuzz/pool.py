"""Warm workers that read variants, each watched: time, memory, exceptions, and what is written where.

The parent has imported everything and forks the workers; it runs nothing itself, so that it has one thread. A worker
that takes too long, grows too much or dies counts as a fault, and another one takes its place.
"""

from __future__ import annotations

import multiprocessing as mp
import os
import resource
import shutil
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from random import Random
from typing import Any

# Imported here, so that workers are forked with everything in place and none is taken for slow.
import av  # noqa: F401
import cv2  # noqa: F401
import OpenImageIO  # noqa: F401
import safetensors.torch  # noqa: F401
import zarr  # noqa: F401

import posegaussian.dags.assets.downloads
import posegaussian.dags.cli.app
import posegaussian.dags.importing.register
import posegaussian.dags.simulation.simulate
import posegaussian.dags.training.config
import posegaussian.dags.training.state
import posegaussian.stages.camera_paths.path_file
import posegaussian.stages.estimators.onnx
import posegaussian.stages.network.asset
import posegaussian.stages.network.model.network
import posegaussian.stages.silhouettes.agreement
import posegaussian.stages.splatting.splat_scene  # noqa: F401
from posegaussian.storage.model.errors import UserError
from tests.fuzz.formats import Format
from tests.fuzz.models import NEVER_WHOLE
from tests.fuzz.spoil import rename, spoil

SECONDS = 10.0
"""Processor time that a variant may take: as long as on a quiet machine, whatever else this one does."""
WAIT = 30.0
"""Seconds after which one that takes no processor time is taken to wait for ever."""
MEMORY = 1_000_000_000
"""Bytes by which a worker may grow."""
PAGE = resource.getpagesize()
SHOWN = 400
"""Letters of a sentence that are kept."""


@dataclass(frozen=True)
class Outcome:
    """What came of one variant."""

    format: str
    index: int
    how: str
    """accepted, refused, traceback, hang, memory, outside, died."""
    damage: str
    """What was done to the file."""
    said: str
    """The sentence, or the exception and where it was raised."""
    seconds: float
    """Of processor time."""
    grown: int
    """Bytes."""


def variant(format: Format, index: int, whole: Path, place: Path) -> Outcome:
    """Make one variant in a fresh folder and read it. Index -1: the whole capture, nothing spoilt."""
    shutil.rmtree(place, ignore_errors=True)
    inside, out, outside = place / "in" / "a" / "capture", place / "in" / "out", place / "outside"
    out.mkdir(parents=True)
    outside.mkdir()
    shutil.copytree(whole, inside, copy_function=os.link)
    random, damage = Random(f"{format.name} {index}"), "nothing"
    if index >= 0:
        damage = (
            rename(inside, random)
            if not format.files
            else spoil(
                random.choice(sorted(p for p in inside.glob(format.files) if p.is_file())), format.kind, outside, random
            )
        )
    before = _listing(place, out)
    start, held = time.process_time(), _reset_peak()
    how, said = _read(format, inside, out)
    seconds, grown = time.process_time() - start, _peak() - held
    if added := sorted(_listing(place, out) ^ before):
        how, said = "outside", f"changed outside its folder: {added[:3]}"
    elif grown > MEMORY:
        how, said = "memory", f"grew by {grown / 1e6:.0f} MB; {said}"
    shutil.rmtree(place, ignore_errors=True)
    return Outcome(format.name, index, how, damage, said[:SHOWN], seconds, grown)


def _read(format: Format, inside: Path, out: Path) -> tuple[str, str]:
    try:
        format.use(inside, out)
    except UserError as e:
        return ("refused", str(e)) if str(e).strip() else ("traceback", f"{type(e).__name__} without a sentence")
    except MemoryError as e:
        return "memory", f"{e!r} at {_where(e)}"
    except BaseException as e:
        return "traceback", f"{type(e).__name__} at {_where(e)}: {e}"
    return "accepted", ""


def _where(error: BaseException) -> str:
    """The innermost line of the project's own."""
    own = [
        f
        for f in traceback.extract_tb(error.__traceback__)
        if any(f"/{p}/" in f.filename for p in ("storage", "stages", "dags")) and "site-packages" not in f.filename
    ]
    return " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in reversed(own[-3:]))


def _listing(place: Path, but: Path) -> set[tuple[str, int, int]]:
    """(path, size, time) of everything below a folder, but for one that may change."""
    return {
        (str(p), s.st_size, s.st_mtime_ns)
        for p in place.rglob("*")
        if not p.is_relative_to(but)
        for s in [p.lstat()]
        if not p.is_dir()
    } | {(str(p), 0, 0) for p in place.rglob("*") if p.is_dir() and not p.is_relative_to(but)}


def _reset_peak() -> int:
    """Bytes this process holds now; its peak counts from here."""
    Path("/proc/self/clear_refs").write_text("5")
    return _resident(os.getpid())


def _peak() -> int:
    return next(
        int(line.split()[1]) * 1024
        for line in Path("/proc/self/status").read_text().splitlines()
        if line.startswith("VmHWM")
    )


def _resident(process: int) -> int:
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * PAGE
    except (OSError, ValueError, IndexError):
        return 0


def _processor(process: int) -> float:
    """Seconds of processor time that a process has taken."""
    try:
        user, system = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return 0.0


def _work(pipe: Connection, formats: dict[str, Format], wholes: Path, place: Path) -> None:
    silent = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silent, stream)
    while (job := pipe.recv()) is not None:
        name, index = job
        pipe.send(variant(formats[name], index, wholes / folder_of(name), place))


def folder_of(name: str) -> str:
    """A format's name as that of a folder."""
    return "".join(c if c.isalnum() else "_" for c in name)


class _Worker:
    def __init__(self, formats: dict[str, Format], wholes: Path, place: Path) -> None:
        self._more = (formats, wholes, place)
        self.job: tuple[str, int] | None = None
        self._start()

    def _start(self) -> None:
        context: Any = mp.get_context("fork")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, *self._more), daemon=True)
        self.process.start()
        theirs.close()

    def give(self, job: tuple[str, int]) -> None:
        self.job, self.since, self.spent, self.first = (
            job,
            time.monotonic(),
            _processor(self.process.pid),
            _resident(self.process.pid),
        )
        self.pipe.send(job)

    def overdue(self, seconds: float) -> Outcome | None:
        """A fault of the variant that is read now, which ends the worker."""
        assert self.job is not None
        grown, took, waited = (
            _resident(self.process.pid) - self.first,
            _processor(self.process.pid) - self.spent,
            time.monotonic() - self.since,
        )
        if grown <= 2 * MEMORY and took <= seconds and waited <= max(seconds, WAIT):
            return None
        return self.replaced("memory" if grown > 2 * MEMORY else "hang", took, grown)

    def replaced(self, how: str, took: float = 0.0, grown: int = 0) -> Outcome:
        assert self.job is not None
        self.process.kill()
        self.process.join()
        said = f"exit status {self.process.exitcode}"
        name, index = self.job
        self._start()
        self.job = None
        return Outcome(name, index, how, "", said, took, grown)

    def end(self) -> None:
        self.process.kill()
        self.process.join()


def run(
    formats: Sequence[Format], jobs: Sequence[tuple[str, int]], work: Path, workers: int, seconds: float = SECONDS
) -> Iterator[Outcome]:
    """The outcome of every (format, index), as they come."""
    by_name = {f.name: f for f in formats}
    team = [_Worker(by_name, work / "whole", work / f"worker{n}") for n in range(workers)]
    todo = list(reversed(jobs))
    try:
        while todo or any(w.job for w in team):
            for w in team:
                if w.job is None and todo:
                    w.give(todo.pop())
            busy = {w.pipe: w for w in team if w.job}
            for pipe in wait(list(busy), timeout=0.1):
                w = busy[pipe]  # type: ignore[index]
                try:
                    outcome = w.pipe.recv()
                    w.job = None
                except (EOFError, OSError):
                    outcome = w.replaced("died")
                yield outcome
            for w in team:
                if w.job and (late := w.overdue(seconds)):
                    yield late
    finally:
        for w in team:
            w.end()


def make_wholes(formats: Sequence[Format], work: Path, workers: int) -> None:
    """Write every whole capture and read it once, with time to compile.
    Raises AssertionError for one that is refused."""
    context: Any = mp.get_context("fork")
    maker = context.Process(target=_make, args=(formats, work / "whole"))
    maker.start()
    maker.join()
    assert maker.exitcode == 0, "a whole capture could not be written"
    for o in run(formats, [(f.name, -1) for f in formats], work, workers, seconds=300):
        assert o.how == "accepted" or o.format in NEVER_WHOLE(), f"{o.format}: the whole capture was {o.how}: {o.said}"


def _make(formats: Sequence[Format], folder: Path) -> None:
    for f in formats:
        f.make(folder / folder_of(f.name))
