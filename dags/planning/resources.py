"""Pools of workers as numbers: what each can serve, and what nobody can, said before a run starts.

Imports no scheduler, so that `plan` can ask.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

import psutil

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.task_cost import needs_of
from posegaussian.stages.contract.declaration import Resources, Stage
from posegaussian.stages.registry import STAGES

CPU, GPU = "CPU", "GPU"
"""Names of the pools, and of the worker resources their tasks ask for."""

MOST_SHARING, CORES_EACH, MEMORY_EACH = 4, 4, 8 * 2**10
"""Workers that share a GPU at most; threads of the processor for each, and MiB of the device. One alone would leave it
idle for most of a frame, while its core reads, lifts and writes. Tasks of eight views of 1024 px declare up to 4 GiB of
it, of 2048 px up to 15: there fewer should share a smaller device, by `run.gpus`."""

MOST_OF = 0.9
"""Share of the machine's memory that one worker may use, above which there is no more to give."""

CGROUP_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
"""Where a container's memory limit is told."""


@dataclass(frozen=True)
class Pool:
    """Workers that serve one kind of task."""

    workers: int
    """Tasks it runs at once."""
    devices: int = 0
    """GPUs of its best equipped worker."""
    ram: int | None = None
    """Memory its largest worker may use, bytes; None: unlimited."""


def visible_gpus() -> list[str]:
    """Indices of the NVIDIA devices of this machine, without importing torch or making a context.

    Of `CUDA_VISIBLE_DEVICES` those before the first negative one, as CUDA reads it: -1 hides all.
    """
    if "CUDA_VISIBLE_DEVICES" in os.environ:
        named = [d.strip() for d in os.environ["CUDA_VISIBLE_DEVICES"].split(",")]
        return [d for d in takewhile(lambda d: not d.startswith("-"), named) if d]
    return (_nvidia_smi("--query-gpu=index", "--format=csv,noheader") or "").split()


def device_memory(device: str) -> int | None:
    """MiB of an NVIDIA device; None where nobody tells."""
    told = _nvidia_smi(f"--id={device}", "--query-gpu=memory.total", "--format=csv,noheader,nounits") or ""
    return int(told) if told.strip().isdigit() else None


@cache
def _nvidia_smi(*words: str) -> str | None:
    """What it prints, asked once a process: every plan wants to know. None where it is not there or fails."""
    if not shutil.which("nvidia-smi"):
        return None
    told = subprocess.run(["nvidia-smi", *words], capture_output=True, text=True, check=False)
    return told.stdout if told.returncode == 0 else None


def gpu_workers(run: Any) -> dict[str, str]:
    """{worker: the device it sees} of `run` settings: several share one where cores and the device's memory allow it.
    Without any device, as many as are asked for stand in for one and see none."""
    devices = visible_gpus()
    if not devices:
        return {f"gpu-{i}": "" for i in range(0 if run.gpus == "auto" else run.gpus)}
    cores = (os.cpu_count() or 1) // (run.threads * len(devices))
    count = sum(_sharing(d, cores) for d in devices) if run.gpus == "auto" else run.gpus
    return {f"gpu-{i}": devices[i % len(devices)] for i in range(count)}


def _sharing(device: str, cores: int) -> int:
    """Workers for a device with so many tasks' cores; one alone where nobody tells how much memory it has."""
    return max(1, min(MOST_SHARING, cores // CORES_EACH, (device_memory(device) or 0) // MEMORY_EACH))


def cpu_workers(run: Any) -> int:
    """Worker processes of the local scheduler: one for each task's cores, but for GPU workers beyond one a device."""
    if run.workers:
        return int(run.workers)
    devices = visible_gpus()
    beyond = max(0, len(gpu_workers(run)) - len(devices)) if devices else 0
    return max(1, (os.cpu_count() or 1) // run.threads - beyond)


def machine_memory() -> int:
    """Bytes this machine, or this container, may use."""
    limits = [psutil.virtual_memory().total]
    for file in CGROUP_LIMITS:
        try:
            limits.append(int(Path(file).read_text()))
        except (OSError, ValueError):
            continue  # no such file, or "max"
    return min(limits)


def local_pools(run: Any) -> dict[str, Pool]:
    """{CPU, GPU: pool} of this machine under `run` settings."""
    if run.scheduler == "serial":
        return {CPU: Pool(1, 0, int(run.memory * 2**20) if run.memory else machine_memory())}
    workers, gpus = cpu_workers(run), gpu_workers(run)
    ram = int(run.memory * 2**20) if run.memory else machine_memory() // (workers + len(gpus))
    return {CPU: Pool(workers, 0, ram)} | ({GPU: Pool(len(gpus), 1, ram)} if gpus else {})


def fitted(run: Any, plans: Iterable[Plan]) -> tuple[Any, tuple[str, ...]]:
    """`run` settings with as many local workers as what the plans are to make leaves memory for, and a sentence where
    that is fewer than there would be else. Of tasks that are larger than the machine, which are refused, none counts.
    A number of workers that the settings name stays, and so does `memory`, of which the machine must have as much for
    each worker."""
    if run.scheduler != "local" or (run.workers and run.gpus != "auto"):
        return run, ()
    memory, workers, gpus = machine_memory(), cpu_workers(run), len(gpu_workers(run))
    if run.memory:
        largest, need, who = None, int(run.memory * 2**20), "run.memory gives each"
    else:
        possible = (t for t in _tasks_to_make(plans) if t.needs.ram <= memory // (2 if gpus else 1))
        largest = max(possible, key=lambda t: t.needs.ram, default=None)
        if largest is None:
            return run, ()
        need, who = largest.needs.ram, f"{largest.who} needs for one task about"
    room = max(1, memory // need)
    fewer = {"gpus": min(gpus, max(1, room - (run.workers or 1)))} if gpus and run.gpus == "auto" else {}
    left = room - fewer.get("gpus", gpus)
    fewer |= {} if run.workers else {"workers": max(1, min(workers, left))}
    found = run.model_copy(update=fewer)
    if (cpu_workers(found), len(gpu_workers(found))) == (workers, gpus):
        return run, ()
    said = (
        f"{_counted(cpu_workers(found), len(gpu_workers(found)))} in place of {_counted(workers, gpus)}: {who}"
        f" {_megabytes(need)}, and this machine has {_megabytes(memory)}"
    )
    return found, (said,)


def _counted(workers: int, gpus: int) -> str:
    return number(workers, "CPU worker") + (f" and {number(gpus, 'GPU worker')}" if gpus else "")


def pool_for(gpu: int, pools: Mapping[str, Pool]) -> str:
    """The pool that serves a task asking for so many GPUs: without any GPU worker, the CPU pool."""
    return GPU if gpu and GPU in pools else CPU


@dataclass(frozen=True)
class _TaskToMake:
    """One of the equal tasks that a plan is to make."""

    stage: Stage
    context: Context
    path: str | None
    needs: Resources

    @property
    def who(self) -> str:
        """Its name in sentences."""
        return f"{self.stage.name} of sequence {self.context.sequence.name}"


def _tasks_to_make(plans: Iterable[Plan]) -> Iterator[_TaskToMake]:
    """One task of each stage and path that the plans are to make."""
    for plan in plans:
        todo = {t.stage for t in plan.to_make}
        for stage in STAGES:
            if stage.name in todo:
                for path in plan.context.paths if "path" in stage.over else [None]:
                    yield _TaskToMake(stage, plan.context, path, needs_of(plan.context, stage, path))


def refusals(plans: Iterable[Plan], pools: Mapping[str, Pool]) -> list[str]:
    """Sentences about work that no worker can do, with what to change."""
    return list(dict.fromkeys(s for task in _tasks_to_make(plans) for s in _refusals(task, pools)))


def _refusals(task: _TaskToMake, pools: Mapping[str, Pool]) -> list[str]:
    needs, who = task.needs, task.who
    name = pool_for(needs.gpu, pools)
    pool = pools.get(name)
    if pool is None:
        return [f"{who} needs a worker without a GPU, and there is none; start one with `dask worker SCHEDULER`"]
    said = []
    if name == GPU and needs.gpu > pool.devices:
        said.append(
            f"{who} asks for {needs.gpu} GPUs a task, the best equipped worker has {pool.devices}; use --scheduler"
            f" tcp://HOST:PORT with workers started with --resources GPU={needs.gpu}, or run.gpus=0 to run it on the"
            " CPU workers"
        )
    if pool.ram is not None and needs.ram > pool.ram:
        *advice, last = [*_more(name, pools), *_shorter(task, pool.ram), f"choose a smaller {task.stage.sized_by}"]
        said.append(
            f"{who} needs about {_megabytes(needs.ram)} for one task, a {name} worker may use {_megabytes(pool.ram)};"
            f" {', '.join([*advice, f'or {last}'] if advice else [last])}"
        )
    return said


def _more(name: str, pools: Mapping[str, Pool]) -> Iterator[str]:
    """Advice about the memory of a worker: whom it is shared with, and how little of the machine's it may use."""
    if name == GPU and not visible_gpus():
        yield "leave run.gpus at auto, for no GPU is seen here"
    shared = [(f"run.{k}", pools[p].workers) for k, p in (("workers", CPU), ("gpus", GPU)) if p in pools]
    fewer = " or ".join(f"{key} (now {count})" for key, count in shared if count > 1)
    if fewer and (name == CPU or visible_gpus()):
        yield f"use fewer {fewer}"
    if (pools[name].ram or 0) < MOST_OF * machine_memory():
        yield "raise run.memory"


def _shorter(task: _TaskToMake, ram: int) -> Iterator[str]:
    """The partition length at which a task would fit, where there is one."""
    stage, context = task.stage, task.context
    lengths = range(1, context.grid.length) if "time" in stage.over else range(0)
    fits = [n for n in lengths if needs_of(context, stage, task.path, n).ram <= ram]
    if fits:
        yield (
            f"cut the sequence into partitions of {fits[-1]} frames (`posegaussian reshard {context.sequence.name}"
            f" --frames {fits[-1]}`)"
        )


def _megabytes(size: int) -> str:
    return f"{size / 2**20:.0f} MB"
