"""Pools of workers as numbers: what each can serve, and what nobody can, said before a run starts.

Imports no scheduler, so that `plan` can ask.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import READY, Plan
from posegaussian.dags.planning.task_cost import needs_of
from posegaussian.stages.contract.declaration import Stage
from posegaussian.stages.registry import STAGES

CPU, GPU = "CPU", "GPU"
"""Names of the pools, and of the worker resources their tasks ask for."""

MOST_SHARING, CORES_EACH, MEMORY_EACH = 4, 4, 4 * 2**10
"""Workers that share a GPU at most; cores of the processor for each, and MiB of the device. One alone leaves it idle
for most of the time: between a frame's kernels its core reads, lifts and writes. For steps of eight 512 px views a
worker needs 0.2 GiB of the device, beside what its libraries take."""

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
    """Indices of the NVIDIA devices of this machine, without importing torch or making a context."""
    if "CUDA_VISIBLE_DEVICES" in os.environ:
        return [d for d in os.environ["CUDA_VISIBLE_DEVICES"].split(",") if d.strip()]
    if not shutil.which("nvidia-smi"):
        return []
    listed = subprocess.run(
        ["nvidia-smi", "--query-gpu=index", "--format=csv,noheader"], capture_output=True, text=True, check=False
    )
    return listed.stdout.split() if listed.returncode == 0 else []


def device_memory(device: str) -> int | None:
    """MiB of an NVIDIA device; None where nobody tells."""
    if not shutil.which("nvidia-smi"):
        return None
    told = subprocess.run(
        ["nvidia-smi", f"--id={device}", "--query-gpu=memory.total", "--format=csv,noheader,nounits"],
        capture_output=True,
        text=True,
        check=False,
    ).stdout.strip()
    return int(told) if told.isdigit() else None


def gpu_workers(gpus: int | str) -> dict[str, str]:
    """{worker: the device it sees} of `run.gpus`: several share one where cores and the device's memory allow it.
    Without any device, as many as are asked for stand in for one and see none."""
    devices = visible_gpus()
    if not devices:
        return {f"gpu-{i}": "" for i in range(0 if gpus == "auto" else int(gpus))}
    count = sum(_sharing(d, len(devices)) for d in devices) if gpus == "auto" else int(gpus)
    return {f"gpu-{i}": devices[i % len(devices)] for i in range(count)}


def _sharing(device: str, devices: int) -> int:
    """Workers for one of so many devices; one alone where nobody tells how much memory it has."""
    memory = device_memory(device)
    cores = (os.cpu_count() or 1) // devices
    return max(1, min(MOST_SHARING, cores // CORES_EACH, (memory or 0) // MEMORY_EACH))


def cpu_workers(run: Any) -> int:
    """Worker processes of the local scheduler: one a core, but for those of GPU workers that share a device."""
    if run.workers:
        return int(run.workers)
    cores = (os.cpu_count() or 1) // run.threads
    return max(1, cores - max(0, len(gpu_workers(run.gpus)) - len(visible_gpus())))


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
    workers, gpus = cpu_workers(run), gpu_workers(run.gpus)
    ram = int(run.memory * 2**20) if run.memory else machine_memory() // (workers + len(gpus))
    return {CPU: Pool(workers, 0, ram)} | ({GPU: Pool(len(gpus), 1, ram)} if gpus else {})


def pool_for(gpu: int, pools: Mapping[str, Pool]) -> str:
    """The pool that serves a task asking for so many GPUs: without any GPU worker, the CPU pool."""
    return GPU if gpu and GPU in pools else CPU


def refusals(plans: Iterable[Plan], pools: Mapping[str, Pool]) -> list[str]:
    """Sentences about work that no worker can do, with what to change."""
    found: dict[str, None] = {}
    for plan in plans:
        for stage in STAGES:
            if any(v.task.stage == stage.name and v.state not in READY for v in plan.verdicts.values()):
                for path in plan.context.paths if "path" in stage.over else [None]:
                    found |= dict.fromkeys(_refusals(stage, plan.context, path, pools))
    return list(found)


def _refusals(stage: Stage, context: Context, path: str | None, pools: Mapping[str, Pool]) -> list[str]:
    sequence = context.sequence.name
    needs = needs_of(context, stage, path)
    name = pool_for(needs.gpu, pools)
    pool = pools.get(name)
    who = f"{stage.name} of sequence {sequence}"
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
        said.append(
            f"{who} needs about {_megabytes(needs.ram)} for one task, a {name} worker may use {_megabytes(pool.ram)};"
            f" use fewer run.workers (now {pool.workers}), raise run.memory,"
            f" {_shorter(stage, context, path, pool.ram)}or choose a smaller frames.size"
        )
    return said


def _shorter(stage: Stage, context: Context, path: str | None, ram: int) -> str:
    """The partition length at which a task would fit, where there is one."""
    fits = (
        [n for n in range(1, context.grid.length) if needs_of(context, stage, path, n).ram <= ram]
        if "time" in stage.over
        else []
    )
    return (
        f"cut the sequence into partitions of {fits[-1]} frames (`posegaussian reshard {context.sequence.name} --frames"
        f" {fits[-1]}`), "
        if fits
        else ""
    )


def _megabytes(size: int) -> str:
    return f"{size / 2**20:.0f} MB"
