"""What running costs besides the work: milliseconds a task, and the share of time that workers are busy.

    python -m benchmarks.pipeline.overhead [--tasks 800] [--busy-tasks 96]

Tasks are real in all but two things: the kernel computes nothing (or sleeps a second), and no shard is written. So what
is measured is judging, ordering, Dask, lease, receipts and their checks; the first row is what Dask alone takes. `fsync
apart` runs with os.fsync switched off,
`with fsync` as always; their difference is what surviving a power cut costs. `ms a task` is what a task adds to a run's
length, once a fifth of the tasks is done and the workers have imported what they need. The busy share is the sum of the
sleeps over two workers times the time from the first task handed out to the last one done, imports and all.
"""

from __future__ import annotations

import argparse
import os
import pickle
import queue
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from distributed import Client

import posegaussian.dags.runtime.executors.child
import posegaussian.dags.runtime.executors.dask
import posegaussian.dags.runtime.worker
from benchmarks.pipeline import synthetic
from benchmarks.report import publish
from posegaussian.dags.config.settings import RunSettings
from posegaussian.dags.planning.resources import CPU
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import Event, TaskDone, TaskFailed, TaskStarted
from posegaussian.dags.runtime.executors.prefetch import MOST
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.work_order import WorkOrder
from posegaussian.dags.runtime.worker import StoreInputs
from posegaussian.stages.contract.declaration import Stage
from posegaussian.stages.contract.io import Block
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.receipts import Output, Receipt
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.spec import ArraySpec, digest

WORKERS = 2
REAL = posegaussian.dags.runtime.worker.execute


def outputs(stage: Stage, order: WorkOrder) -> Iterator[Block]:
    """An empty block for everything a task would write."""
    for spec in stage.writes_for(order.scope.facts):
        every = isinstance(spec, ArraySpec) and spec.per_view and order.scope.view is None
        for view in range(len(order.scope.rig)) if every else [order.scope.view]:
            yield Block(spec.name, None, view)


def write_nothing(sequence: SequenceGroup, stage: Stage, order: WorkOrder, block: Block, lease: Lease) -> Output:
    """The record of a shard that is not there."""
    name = block.array.format(path=order.path_name)
    return Output(name, block.view, digest([name, block.view, order.partition]), ())


def task(order: WorkOrder, seconds: float, sync: bool) -> Receipt:
    """One task whose kernel sleeps; the worker's modules are changed for its lifetime."""

    def kernel(inputs: StoreInputs, params: Any) -> Iterator[Block]:
        if seconds:  # even a sleep of nothing gives the processor away
            time.sleep(seconds)
        return outputs(stage, order)

    stage = posegaussian.dags.runtime.worker.stage_named(order.stage)
    posegaussian.dags.runtime.worker.resolve = lambda dotted: (
        kernel if dotted.endswith(":run") else lambda block, params: []
    )
    posegaussian.dags.runtime.worker._write = write_nothing
    if not sync:
        os.fsync = lambda fd: None
    return REAL(order)


def packed(build: str, order: bytes, seconds: float, sync: bool) -> bytes:
    """`task` as a Dask worker gets it."""
    return pickle.dumps(task(pickle.loads(order), seconds, sync))


def timed(count: int, scheduler: str, seconds: float, sync: bool) -> dict[str, Any]:
    """Run about `count` tasks: how many, seconds from first start to last end, and milliseconds each once warm."""
    starts: list[float] = []
    ends: list[float] = []
    fsync = os.fsync

    def note(event: Event) -> None:
        if isinstance(event, TaskStarted):
            starts.append(time.perf_counter())
        elif isinstance(event, TaskDone):
            ends.append(time.perf_counter())
        elif isinstance(event, TaskFailed):
            raise SystemExit(f"{event.error}\n{event.details}")

    function = partial(task, seconds=seconds, sync=sync)
    posegaussian.dags.runtime.executors.child.execute = function
    posegaussian.dags.runtime.executors.dask.execute_packed = partial(packed, seconds=seconds, sync=sync)
    with tempfile.TemporaryDirectory() as folder:
        session = synthetic.make(
            Path(folder),
            max(1, round(count / synthetic.TASKS)),
            receipts=False,
            more=(f"run.scheduler={scheduler}", f"run.workers={WORKERS}"),
        )
        plan = session.plan(synthetic.NAME, Selection())
        Run([plan], Selection(), session.backend(), [note]).go()
    os.fsync = fsync
    warm = len(ends) // 5
    return {
        "tasks": len(ends),
        "seconds": ends[-1] - starts[0],
        "ms a task": (ends[-1] - ends[warm]) / (len(ends) - 1 - warm) * 1e3,
    }


def nothing(order: bytes) -> bytes:
    return order


def bare_dask(count: int) -> dict[str, Any]:
    """The same number of futures of eight kilobytes through the same cluster, with the window our tasks of this
    length have and none of our code around them."""
    settings = RunSettings(workers=WORKERS, gpus=0)
    ended: queue.SimpleQueue[str] = queue.SimpleQueue()
    ends = []
    with (
        posegaussian.dags.runtime.executors.dask.start_local(settings) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        client.wait_for_workers(WORKERS)

        async def fetch(key: str, future: Any) -> None:
            await future
            ended.put(key)

        flying: dict[str, Any] = {}
        start = time.perf_counter()
        for i in range(count):
            if len(flying) == WORKERS * MOST:
                del flying[ended.get()]
                ends.append(time.perf_counter())
            key = f"nothing-{i}"
            flying[key] = client.submit(nothing, bytes(8000), key=key, pure=False, resources={CPU: 1})
            client.loop.add_callback(fetch, key, flying[key])
    warm = count // 5
    return {
        "tasks": count,
        "seconds": ends[-1] - start,
        "ms a task": (ends[-1] - ends[warm]) / (len(ends) - 1 - warm) * 1e3,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", type=int, default=800)
    parser.add_argument("--busy-tasks", type=int, default=96)
    arguments = parser.parse_args()
    bare = bare_dask(arguments.tasks)
    rows = [{"tasks are": f"bare Dask futures, {WORKERS} workers", **bare, "busy %": ""}]
    for name, scheduler, seconds, sync in (
        ("no-op, serial, fsync apart", "serial", 0.0, False),
        ("no-op, serial, with fsync", "serial", 0.0, True),
        (f"no-op, {WORKERS} workers, fsync apart", "local", 0.0, False),
        (f"no-op, {WORKERS} workers, with fsync", "local", 0.0, True),
        (f"1 s each, {WORKERS} workers", "local", 1.0, True),
    ):
        r = timed(arguments.busy_tasks if seconds else arguments.tasks, scheduler, seconds, sync)
        busy = f"{100 * r['tasks'] * seconds / (WORKERS * r['seconds']):.1f}" if seconds else ""
        rows.append(
            {
                "tasks are": name,
                "tasks": r["tasks"],
                "seconds": r["seconds"],
                "ms a task": "" if seconds else r["ms a task"],
                "busy %": busy,
            }
        )
    publish("overhead", rows, vars(arguments))


if __name__ == "__main__":
    main()
