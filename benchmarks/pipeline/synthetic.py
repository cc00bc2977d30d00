"""Archives of any length without pictures:
true receipts over empty shards, for measuring plans, status and the ledger."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from posegaussian.dags.config.effect_settings import declared
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.fingerprint import all_parts, own_parts
from posegaussian.dags.planning.tasks import Task, inputs, producer, tasks
from posegaussian.dags.session.session import Session
from posegaussian.stages.registry import stage
from posegaussian.storage.archive.receipts import Output, Receipt, ShardFile, receipt_file
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.cameras import Rig, rigid
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.model.spec import ArraySpec, digest

NAME = "synthetic"
TASKS = 8
"""Tasks of one partition of time: three of frames, one of every later stage that has work."""
FACTS = {
    "started": "2026-01-01T00:00:00.000+00:00",
    "seconds": 1.0,
    "cpu_seconds": 1.0,
    "host": "h",
    "pid": 1,
    "worker": "cpu-0",
    "device": "cpu",
    "threads": 1,
    "peak_rss": 2**30,
    "libraries": {f"library{i}": "1.0" for i in range(8)},
}
"""Facts like those of a real receipt."""
SETTINGS = ("views.held_out=[cam2]", "partition.frames=1", *(f"effects.{name}=off" for name in declared()))
"""No effect is left to a survey, which has no pictures to look at."""


def capture(frames: int) -> Capture:
    """Two source cameras and one held out, a video each; no file exists."""
    turns = (0.0, 0.8, 0.4)
    motions = np.stack(
        [
            rigid(np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]]), np.array([0, 0, 3]))
            for a in turns
        ]
    )
    names, size = tuple(f"cam{i}" for i in range(3)), (64, 48)
    rig = Rig(
        names,
        np.tile(np.array([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]]), (3, 1, 1)),
        np.zeros((3, 8)),
        motions,
        np.tile(np.array(size), (3, 1)),
    )

    def videos(what: str, **options: str) -> tuple[Stream, ...]:
        files = [SourceFile(f"/nowhere/{what}-{n}", digest([what, n]) * 2, 1, 1) for n in names]
        return tuple(Stream("video", (f,), tuple(range(frames)), size, dict(options)) for f in files)

    return Capture(
        "images", rig, 30.0, videos("pictures"), masks=videos("masks"), joints=videos("joints", joint_set="coco17")
    )


def session(root: Path, more: tuple[str, ...] = ()) -> Session:
    """A session over the archive in `root`; `more` are settings."""
    return Session(load_configuration(None, [*SETTINGS, *more], folder=root), str(root), Console(quiet=True))


def make(root: Path, frames: int, receipts: bool = True, more: tuple[str, ...] = ()) -> Session:
    """Register `frames` partitions of one frame; with `receipts` as if all of them had been made."""
    Archive.open(str(root), create=True).create_sequence(NAME, capture(frames), 1)
    made = session(root, more)
    if receipts:
        write(made.context(NAME))
    return made


def make_many(root: Path, sequences: int, frames: int) -> Session:
    """Register that many sequences of `frames` partitions each, as if all of them had been made."""
    archive = Archive.open(str(root), create=True)
    for n in range(sequences):
        archive.create_sequence(f"{NAME}{n:04d}", capture(frames), 1)
    made = session(root)
    for n in range(sequences):
        write(made.context(f"{NAME}{n:04d}"))
    return made


def write(context: Context) -> int:
    """Write receipts and empty shards of every task, in the order of flow; returns how many tasks."""
    outputs: dict[Task, dict[tuple[str, int | None], Output]] = {}
    root, count = context.sequence.root, 0
    for task in tasks(context):
        digests = {
            p: outputs[producer(p, task)][p.array, p.view].digest for i in inputs(context, task) for p in i.products
        }
        parts = all_parts(context, task, own_parts(context, task), digests)
        made = _outputs(context, task)
        for output in made:
            for f in output.files:
                (root / f.key).parent.mkdir(parents=True, exist_ok=True)
                (root / f.key).touch()
        outputs[task] = {(o.array, o.view): o for o in made}
        file = receipt_file(context.sequence, *task[1:])
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(
            Receipt(
                task.stage, task.partition, task.view, task.path, digest(parts), parts, tuple(made), (), FACTS
            ).to_json()
        )
        count += 1
    return count


def _outputs(context: Context, task: Task) -> list[Output]:
    """What a task would have written, one empty file an output."""
    found = []
    for spec in stage(task.stage).writes_for(context.facts):
        name = spec.name.format(path=task.path)
        every = isinstance(spec, ArraySpec) and spec.per_view and task.view is None
        for view in range(len(context.rig)) if every else [task.view]:
            key = (
                f"{name}/c.{task.partition or 0}.{0 if view is None else view}"
                if isinstance(spec, ArraySpec)
                else f"{name}/p{task.partition:06d}.parquet"
            )
            found.append(Output(name, view, digest([name, view, task.partition]), (ShardFile(key, 0, 0),)))
    return found
