"""The Dask back end: futures, one a task, with a window of our own for every pool of workers.

Futures and not collections, because resource tags on collections are lost when tasks are fused; a window of our own,
because a resource tag switches off the scheduler's back-pressure.
"""

from __future__ import annotations

import logging
import os
import shutil
import signal
import subprocess
from typing import Any

from dags import threads
from dags.execute import Order, execute
from dags.run import Failure
from dags.serial import failure
from dags.tasks import Task
from storage.errors import ConfigError
from storage.receipts import Receipt

GPU = "GPU"
"""Name of the worker resource a GPU task asks for."""


def visible_gpus() -> list[str]:
    """Indices of the NVIDIA devices of this machine, without importing torch or making a context."""
    if "CUDA_VISIBLE_DEVICES" in os.environ:
        return [d for d in os.environ["CUDA_VISIBLE_DEVICES"].split(",") if d.strip()]
    if not shutil.which("nvidia-smi"):
        return []
    listed = subprocess.run(["nvidia-smi", "--query-gpu=index", "--format=csv,noheader"], capture_output=True, text=True, check=False)
    return listed.stdout.split() if listed.returncode == 0 else []


def start_local(workers: int | None, cpus: int) -> Any:
    """A cluster of this machine: one process a CPU worker, and one for every GPU, which sees that device alone."""
    import dask
    from distributed import Nanny, Scheduler, SpecCluster

    # A failed task is reported by the run, with its sentence; Dask's own report would say it again with a traceback.
    environment = {**threads.environment(cpus), "DASK_LOGGING__DISTRIBUTED": "critical"}
    dask.config.set({"distributed.scheduler.worker-ttl": "30 minutes", "distributed.nanny.pre-spawn-environ": {**environment, **threads.allocator()}})
    names = {f"cpu-{i}": "" for i in range(workers or max(1, (os.cpu_count() or 1) // cpus))} | {f"gpu-{d}": d for d in visible_gpus()}
    spec = {name: {"cls": Nanny, "options": _worker_options(name, device, environment)} for name, device in names.items()}
    scheduler = {"cls": Scheduler, "options": {"dashboard": False, "dashboard_address": "127.0.0.1:0", "host": "127.0.0.1"}}
    return SpecCluster(workers=spec, scheduler=scheduler, silence_logs=logging.CRITICAL)


def _worker_options(name: str, device: str, environment: dict[str, str]) -> dict[str, Any]:
    """Options of one worker process of one thread; `device` is the only GPU it sees, or "" for none."""
    return {
        "name": name,
        "nthreads": 1,
        "memory_limit": 0,
        "dashboard": False,
        "silence_logs": logging.CRITICAL,
        "resources": {GPU: 1} if device else {},
        "env": {**environment, "POSEGAUSSIAN_WORKER": name, "CUDA_VISIBLE_DEVICES": device},
    }


def ignore_interrupts() -> None:
    """Have a worker ignore Ctrl-C: a terminal sends it to the workers too, and the driver alone decides what it means."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class DaskBackend:
    """`dags.run.Backend` over a Dask scheduler: a local cluster of our own, or one given by address."""

    def __init__(self, address: str | None = None, workers: int | None = None, cpus: int = 1, window: int = 2) -> None:
        """Start or reach the cluster. Raises ConfigError when the address does not answer or has no workers."""
        from distributed import Client, as_completed

        self._cluster = start_local(workers, cpus) if address is None else None
        try:
            self._client = Client(self._cluster or address, timeout="10s", set_as_default=False)
        except OSError as e:
            raise ConfigError(f"run.scheduler: no scheduler answers at {address} ({e}); start one with `dask scheduler`, or use --scheduler local") from e
        if self._cluster is not None:
            self._client.wait_for_workers(len(self._cluster.worker_spec), timeout=120)
            self._client.run(ignore_interrupts)
        found = self._client.scheduler_info(n_workers=-1)["workers"].values()
        gpu = sum(1 for w in found if w["resources"].get(GPU, 0) >= 1)
        cpu = sum(w["nthreads"] for w in found) - gpu
        if not found:
            self.close()
            raise ConfigError(f"run.scheduler: {address} has no workers; start some with `dask worker {address}`")
        self._has_gpu = gpu > 0
        self._capacity = {True: gpu * window, False: max(cpu, 1 if not gpu else 0) * window}
        self._flying: dict[bool, int] = {True: 0, False: 0}
        self._tasks: dict[Any, tuple[Task, bool]] = {}
        self._done = as_completed(loop=self._client.loop, raise_errors=False)
        self._attempts = 0
        where = "this machine" if address is None else address
        placed = f"rendering is pinned to {gpu} GPU worker(s)" if gpu else "no worker has a GPU: rendering runs on the CPU workers"
        self.sentences: tuple[str, ...] = (f"running on {where} with {cpu} CPU worker(s); {placed}",)

    def _pool(self, gpu: bool) -> bool:
        return gpu and self._has_gpu

    def free(self, gpu: bool) -> int:
        """Room in the window of the pool that serves such tasks."""
        pool = self._pool(gpu)
        return self._capacity[pool] - self._flying[pool]

    def submit(self, task: Task, order: Order) -> None:
        """One future; the key groups by stage on Dask's dashboard."""
        pool = self._pool(order.gpu)
        self._attempts += 1
        resources = {GPU: 1} if pool else None
        future = self._client.submit(execute, order, key=f"{task.stage}-{os.getpid():x}-{self._attempts:08x}", pure=False, resources=resources)
        self._tasks[future] = (task, pool)
        self._flying[pool] += 1
        self._done.add(future)

    def next_done(self) -> tuple[Task, Receipt | Failure]:
        """The next finished future, its result or its error."""
        future = next(self._done)
        task, pool = self._tasks.pop(future)
        self._flying[pool] -= 1
        error = future.exception()
        if error is None:
            return task, future.result()
        if type(error).__name__ == "KilledWorker":
            return task, Failure("its worker died several times, most likely for want of memory; import with a smaller partition.frames, or use fewer run.workers", "")
        return task, failure(error)

    def close(self) -> None:
        """Cancel what is in flight and, for a cluster of our own, end its workers."""
        if self._tasks if hasattr(self, "_tasks") else False:
            self._client.cancel(list(self._tasks), force=True)
        self._client.close(timeout=5)
        if self._cluster is not None:
            self._cluster.close(timeout=10)
