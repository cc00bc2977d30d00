"""The Dask back end: futures, one a task, on a cluster of this machine or on one given by address.

Futures and not collections, because resource tags on collections are lost when tasks are fused. Attempts are counted
by the run and not by the scheduler: `allowed-failures` is 0, and a task's lease tells whether it was running when its
worker died, or only waiting there.
"""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import queue
import signal
import time
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dags import threads
from dags.config import RunSettings
from dags.execute import Order, execute
from dags.failures import Failure, Kind, failure
from dags.pools import CPU, GPU, Pool, cpu_workers, gpu_workers, local_pools, pool_for
from dags.tasks import Task
from dags.window import Window
from dags.wording import number
from storage.archive import Sequence
from storage.errors import ConfigError, SchedulerLost
from storage.lease import read_lease
from storage.receipts import Receipt, lease_file

LOOK_AGAIN = 5.0
"""Seconds between two looks at which workers an external scheduler has."""

PATIENCE = 1.0
"""Seconds between two looks at whether the scheduler is still there, while nothing ends."""

ABANDONED = 60.0
"""Seconds after which tasks that no worker of an external scheduler can serve any more are given up."""

RECONNECTION = 30.0
"""Seconds a lost connection to the scheduler has to come back."""

CONFIGURATION = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-ttl": "30 minutes",  # a kernel that is being compiled may hold the interpreter for long
    "distributed.worker.daemon": True,
    "distributed.worker.memory.target": False,  # nothing is kept on workers that could be spilt,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,  # and a paused worker would wait for ever: over the limit it ends
    "distributed.worker.memory.terminate": 0.95,
    "logging.distributed": "critical",
}
"""What a cluster of our own is started with."""


def start_local(settings: RunSettings) -> Any:
    """A cluster of this machine: one process a CPU worker, and one for every GPU, which sees that device alone."""
    import dask
    from distributed import Nanny, Scheduler, SpecCluster

    # A failed task is reported by the run, with its sentence; Dask's own report would say it again with a traceback.
    common = {**threads.environment(settings.threads), "DASK_LOGGING__DISTRIBUTED": "critical"}
    dask.config.set({**CONFIGURATION, "distributed.nanny.pre-spawn-environ": {**common, **threads.allocator()}})
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # for good: while it closes, the cluster's own silence is over, and a late message ends in a traceback
    os.environ.setdefault("PYTHONWARNINGS", "ignore::UserWarning:multiprocessing.resource_tracker")  # it counts what killed workers leave
    pools = local_pools(settings)
    devices = {f"cpu-{i}": None for i in range(cpu_workers(settings))} | gpu_workers(settings.gpus)
    spec: dict[str, Any] = {}
    for name, device in devices.items():
        pool = CPU if device is None else GPU
        environment = {**common, "CUDA_VISIBLE_DEVICES": device or ""}
        options = {"name": name, "nthreads": 1, "memory_limit": pools[pool].ram, "resources": {pool: 1}, "env": environment, "dashboard": False, "silence_logs": logging.CRITICAL}
        spec[name] = {"cls": Nanny, "options": options}
    return SpecCluster(workers=spec, scheduler={"cls": Scheduler, "options": {"dashboard": False, "dashboard_address": "127.0.0.1:0", "host": "127.0.0.1"}}, silence_logs=logging.CRITICAL)


def deaf() -> None:
    """Have this worker ignore Ctrl-C: a terminal sends it to the workers too, and the driver alone decides what it means."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def look(folder: str) -> tuple[bool, str]:
    """Asked of a worker: (whether it sees the archive, digest of its code of all stages)."""
    from dags.code import code_digest
    from stages.registry import STAGES
    from storage.spec import digest

    return Path(folder).is_dir(), digest([code_digest(s.run) for s in STAGES])


@dataclass(frozen=True)
class _Workers:
    """The workers a scheduler has, as pools."""

    pools: dict[str, Pool]
    tagged: bool
    """Whether all CPU workers declare the CPU resource, so that a tag keeps CPU work off the GPU workers."""
    cpu: tuple[str, ...]
    """Addresses of the workers without a GPU."""

    @classmethod
    def of(cls, found: dict[str, Any]) -> _Workers:
        """From `client.scheduler_info()["workers"]`."""
        gpu = {a: w for a, w in found.items() if w["resources"].get(GPU, 0) >= 1}
        cpu = {a: w for a, w in found.items() if a not in gpu}
        pools = {}
        if cpu or gpu:
            chosen = cpu or gpu  # a cluster of GPU workers alone does the CPU work too
            pools[CPU] = Pool(sum(w["nthreads"] for w in chosen.values()), 0, _limit(chosen))
        if gpu:
            devices = [int(w["resources"][GPU]) for w in gpu.values()]
            pools[GPU] = Pool(sum(min(d, w["nthreads"]) for d, w in zip(devices, gpu.values(), strict=True)), max(devices), _limit(gpu))
        return cls(pools, bool(cpu) and all(w["resources"].get(CPU, 0) >= 1 for w in cpu.values()), tuple(cpu))


def _limit(workers: dict[str, Any]) -> int | None:
    limits = [w["memory_limit"] for w in workers.values()]
    return max(limits) if all(limits) else None


class DaskBackend:
    """`dags.flight.Backend` over a Dask scheduler: a local cluster of our own, or one given by address."""

    def __init__(self, settings: RunSettings | None = None, archive: Path | None = None) -> None:
        """Start or reach the cluster. Raises ConfigError when the address does not answer, has no workers, or has workers that cannot do the work."""
        from distributed import Client

        settings = settings or RunSettings()
        self._address = None if settings.scheduler in ("local", "serial") else settings.scheduler
        self._windows: defaultdict[str, Window] = defaultdict(partial(Window, settings.window))
        self._tasks: dict[Any, tuple[Task, Order, str]] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._attempts = 0
        self._served = time.monotonic()
        self._cluster = start_local(settings) if self._address is None else None
        try:
            self._client = Client(self._cluster or self._address, timeout="5s", set_as_default=False)
        except OSError as e:
            raise ConfigError(f"run.scheduler: no scheduler answers at {self._address} ({e}); start one with `dask scheduler`, or use --scheduler local") from e
        try:
            self._meet(archive)
        except BaseException:
            self.close(hard=True)
            raise
        self.sentences: tuple[str, ...] = (self._sentence(),)

    def _meet(self, archive: Path | None) -> None:
        """Wait for our own workers, or look at those of others."""
        if self._cluster is not None:
            self._client.wait_for_workers(len(self._cluster.worker_spec), timeout=120)
            self._client.register_plugin(_deafness(), name="posegaussian-ctrl-c")
        self._look()
        if not self._workers.pools:
            raise ConfigError(f"run.scheduler: {self._address} has no workers; start some with `dask worker {self._address}`")
        if self._cluster is not None or archive is None:
            return
        try:
            found = self._client.run(look, str(archive))
        except Exception as e:
            raise ConfigError(f"run.scheduler: the workers of {self._address} cannot run posegaussian ({type(e).__name__}: {e}); install the same version there") from e
        own = look(str(archive))[1]
        for worker, (sees, code) in found.items():
            if not sees:
                raise ConfigError(f"run.scheduler: worker {worker} does not see the archive {archive}; mount it there at the same path")
            if code != own:
                raise ConfigError(f"run.scheduler: worker {worker} has another version of the stages than this process; install the same version there")

    def _sentence(self) -> str:
        cpu, gpu = self._workers.pools.get(CPU), self._workers.pools.get(GPU)
        placed = f"GPU work is pinned to {number(gpu.workers, 'GPU worker')}" if gpu else "no worker has a GPU: rendering runs on the CPU workers"
        return f"running on {self._address or 'this machine'} with {number(cpu.workers if cpu else 0, 'CPU worker')}; {placed}"

    @property
    def pools(self) -> dict[str, Pool]:
        """What the workers can serve."""
        return self._workers.pools

    def _look(self) -> None:
        self._workers = _Workers.of(self._client.scheduler_info(n_workers=-1)["workers"])
        self._looked = time.monotonic()

    def _look_again(self) -> None:
        """Workers of an external scheduler may come and go. Raises SchedulerLost when those that are needed stay away."""
        if self._cluster is not None or time.monotonic() - self._looked < LOOK_AGAIN:
            return
        self._connected()
        self._look()
        missing = {pool for _, _, pool in self._tasks.values()} - self._workers.pools.keys()
        self._served = self._served if missing else time.monotonic()
        if time.monotonic() - self._served > ABANDONED:
            raise SchedulerLost(f"{self._address} has had no {' and no '.join(sorted(missing))} worker for {ABANDONED:.0f} s; what is done is kept, start workers and run again")

    def pool(self, gpu: int) -> str:
        """The GPU pool for what asks for a GPU, where there is one."""
        return pool_for(gpu, self._workers.pools)

    def free(self, pool: str) -> int:
        """Room in a pool's window."""
        self._look_again()
        workers = self._workers.pools[pool].workers if pool in self._workers.pools else 1
        return workers * self._windows[pool].tasks - sum(p == pool for _, _, p in self._tasks.values())

    def _connected(self) -> None:
        """Wait for a lost connection to come back. Raises SchedulerLost."""
        end = time.monotonic() + RECONNECTION
        while self._client.status != "running":
            if self._client.status not in ("connecting", "newly-created") or time.monotonic() > end:
                raise SchedulerLost(f"the scheduler {self._address or 'of this machine'} does not answer any more; what is done is kept, run again")
            time.sleep(0.1)

    def submit(self, task: Task, order: Order) -> None:
        """One future; the key groups by stage on Dask's dashboard. Raises SchedulerLost."""
        self._connected()
        pool = self.pool(order.gpu)
        self._attempts += 1
        where: dict[str, Any] = {}
        if pool == GPU:
            where = {"resources": {GPU: order.gpu}}
        elif self._workers.tagged:
            where = {"resources": {CPU: 1}}
        elif GPU in self._workers.pools:
            where = {"workers": self._workers.cpu, "allow_other_workers": True}
        future = self._client.submit(execute_packed, pickle.dumps(order), key=f"{task.stage}-{order.terms.run}-{self._attempts:08d}", pure=False, **where)
        self._tasks[future] = (task, order, pool)
        self._client.loop.add_callback(self._await, future)  # type: ignore[union-attr]  # it has a loop while it is open

    async def _await(self, future: Any) -> None:
        """Fetch a result on the client's own thread as soon as it is there: asked for by `next_done`, one after the other, fetching took longer than the work around a task."""
        try:
            outcome = await future
        except (Exception, asyncio.CancelledError) as e:
            outcome = e
        self._ended.put((future, outcome))

    def next_done(self, seconds: float | None = None) -> tuple[Task, Receipt | Failure] | None:
        """The next finished future, its result or its error; raises SchedulerLost when nobody answers any more."""
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            left = PATIENCE if end is None else min(PATIENCE, end - time.monotonic())
            try:
                future, outcome = self._ended.get(timeout=max(0.0, left))
                break
            except queue.Empty:
                self._connected()
                self._look_again()
                if end is not None and time.monotonic() >= end:
                    return None
        task, order, pool = self._tasks.pop(future)
        if isinstance(outcome, bytes):
            receipt = pickle.loads(outcome)
            self._windows[pool].note(receipt.facts["seconds"])
            return task, receipt
        if future.status in ("cancelled", "lost"):
            return task, Failure("the connection to the scheduler was lost while it ran", kind=Kind.TRANSIENT)
        return task, _death(order) if type(outcome).__name__ == "KilledWorker" else failure(outcome)

    def close(self, hard: bool = False) -> None:
        """Cancel what is in flight and, for a cluster of our own, end its workers: at once where hard.

        What runs on an external scheduler's workers goes on to the end of its task, whose lease it holds until then.
        """
        if self._cluster is not None and hard:
            self.kill()
        if self._tasks and self._client.status == "running":
            self._client.cancel(list(self._tasks), force=True)
        self._client.close(timeout=5)
        if self._cluster is not None:
            self._cluster.close(timeout=10)

    def kill(self) -> None:
        """End our own workers in the middle of what they do; their leases end with them."""
        for nanny in self._cluster.workers.values() if self._cluster is not None else ():
            nanny.close_gracefully(reason="interrupted")  # or it would start a new worker
            if nanny.pid is not None:
                os.kill(nanny.pid, signal.SIGKILL)


def execute_packed(order: bytes) -> bytes:
    """`execute` between pickles: as one piece of bytes an order is a message of one part; as an object Dask would send each of its arrays as a part of its own."""
    return pickle.dumps(execute(pickle.loads(order)))


def _deafness() -> Any:
    from distributed import WorkerPlugin

    class Deafness(WorkerPlugin):
        def setup(self, worker: Any) -> None:
            deaf()

    return Deafness()


def _death(order: Order) -> Failure:
    """What a worker's death means for a task that was on it, from the task's lease."""
    holder = read_lease(lease_file(Sequence(order.root), order.key), order.terms.lease)
    if holder is None or holder.run != order.terms.run:
        return Failure("the worker it waited on died", kind=Kind.SPARED)
    if holder.ended:
        return Failure(holder.ended, kind=Kind.TIMEOUT)
    return Failure(f"its worker {holder.worker} died: killed for memory, or crashed", kind=Kind.MEMORY)
