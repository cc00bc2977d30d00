"""The Dask back end: futures, one a task, on a cluster of this machine or on one given by address.

Futures and not collections, because resource tags on collections are lost when tasks are fused. Attempts are counted
by the run and not by the scheduler: `allowed-failures` is 0, and a task's lease tells whether it was running when its
worker died, or only waiting there.

Workers of others are asked for their code and libraries before they get anything, and every task carries the digest of
ours besides: a worker that is not of this build refuses it, and it goes to one that is.
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
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from posegaussian.dags.config.settings import RunSettings
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.resources import CPU, GPU, Pool, pool_for, visible_gpus
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.provenance import builds
from posegaussian.dags.runtime.executors.dask_worker import Introduction, execute_packed, introduce
from posegaussian.dags.runtime.executors.local_cluster import start_local
from posegaussian.dags.runtime.executors.prefetch import Window
from posegaussian.dags.runtime.failures import Failure, Kind, failure
from posegaussian.dags.runtime.timeout import death
from posegaussian.dags.runtime.work_order import WorkOrder
from posegaussian.storage.archive.receipts import Receipt
from posegaussian.storage.model.errors import ConfigError, OtherCode, SchedulerLost

LOOK_AGAIN = 5.0
"""Seconds between two looks at which workers an external scheduler has."""

PATIENCE = 1.0
"""Seconds between two looks at whether the scheduler is still there, while nothing ends."""

ABANDONED = 60.0
"""Seconds after which tasks that no worker of an external scheduler can serve any more are given up."""

RECONNECTION = 30.0
"""Seconds a lost connection to the scheduler has to come back."""


@dataclass(frozen=True)
class _Workers:
    """The workers a scheduler has, as pools."""

    pools: dict[str, Pool]
    tagged: bool
    """Whether all CPU workers declare the CPU resource, so that a tag keeps CPU work off the GPU workers."""
    addresses: dict[str, frozenset[str]]
    """Of the workers of each pool."""

    @classmethod
    def of(cls, found: dict[str, Any]) -> _Workers:
        """From `client.scheduler_info()["workers"]`."""
        gpu = {a: w for a, w in found.items() if w["resources"].get(GPU, 0) >= 1}
        cpu = {a: w for a, w in found.items() if a not in gpu}
        pools = {}
        chosen = cpu or gpu  # a cluster of GPU workers alone does the CPU work too
        if chosen:
            pools[CPU] = Pool(sum(w["nthreads"] for w in chosen.values()), 0, _limit(chosen))
        if gpu:
            devices = [int(w["resources"][GPU]) for w in gpu.values()]
            pools[GPU] = Pool(
                sum(min(d, w["nthreads"]) for d, w in zip(devices, gpu.values(), strict=True)),
                max(devices),
                _limit(gpu),
            )
        return cls(
            pools,
            bool(cpu) and all(w["resources"].get(CPU, 0) >= 1 for w in cpu.values()),
            {CPU: frozenset(chosen), GPU: frozenset(gpu)},
        )


def _limit(workers: dict[str, Any]) -> int | None:
    limits = [w["memory_limit"] for w in workers.values()]
    return max(limits) if all(limits) else None


@dataclass(frozen=True)
class _Flown:
    """A task that was handed to the scheduler."""

    task: Task
    order: WorkOrder
    pool: str
    where: frozenset[str]
    """Addresses of the workers it may run on; empty for all of the pool."""


class DaskBackend:
    """`posegaussian.dags.runtime.in_flight.Backend` over a Dask scheduler: a local cluster of our own, or one given
    by address."""

    def __init__(self, settings: RunSettings | None = None, archive: Path | None = None) -> None:
        """Start or reach the cluster.

        Raises ConfigError when the address does not answer, has no workers, or none that can do the work, SchedulerLost
        when workers of our own cannot be started, and OtherCode when files of this process were edited since it began.
        """
        settings = settings or RunSettings()
        self._build, self._archive = builds.here(), archive
        self._address = None if settings.scheduler in ("local", "serial") else settings.scheduler
        self._windows: defaultdict[str, Window] = defaultdict(partial(Window, settings.window))
        self._tasks: dict[Any, _Flown] = {}
        self._parked: list[tuple[Task, WorkOrder]] = []
        """Tasks that no worker can be given now."""
        self._fit: set[str] = set()
        """Addresses of workers of others that introduced themselves as of this build."""
        self._unfit: dict[str, str] = {}
        """Why a worker is given nothing, by address."""
        self._news: list[str] = []
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._attempts = 0
        self._served = time.monotonic()
        self._cluster = start_local(settings) if self._address is None else None
        self._client = _connect(self._cluster or self._address, self._address)
        try:
            self._meet()
        except BaseException:
            self.close(hard=True)
            raise
        self.sentences: tuple[str, ...] = (self._sentence(), *self.news())

    def _meet(self) -> None:
        """Wait for our own workers, or look at those of others."""
        if self._cluster is not None:
            try:
                self._client.wait_for_workers(len(self._cluster.worker_spec), timeout=120)
            except OSError as e:
                raise SchedulerLost(f"the workers of this machine died while they started ({e}); run again") from e
        self._look()
        if not self._workers.pools and self._unfit:
            raise ConfigError("\n".join(f"run.scheduler: {why}" for why in self._unfit.values()))
        if not self._workers.pools:
            raise ConfigError(
                f"run.scheduler: {self._address} has no workers; start some with `dask worker {self._address}`"
            )

    def _vet(self, addresses: list[str]) -> None:
        """Ask workers of others who they are; those that do not answer now are asked again at the next look."""
        said: dict[str, Any] = {}
        with suppress(OSError):  # of the scheduler itself: whether it is lost is told by `_connected`
            said = (
                self._client.run(
                    introduce, str(self._archive) if self._archive else None, workers=addresses, on_error="return"
                )
                if addresses
                else {}
            )
        for address, answer in said.items():
            if isinstance(answer, Introduction):
                if why := self._objection(f"worker {address} (process {answer.pid} on {answer.host})", answer):
                    self._leave_out(address, why)
                else:
                    self._fit.add(address)
            elif isinstance(answer, OtherCode):
                self._leave_out(address, f"worker {address}: {answer}")
            elif not isinstance(answer, OSError):
                self._leave_out(
                    address,
                    f"worker {address} cannot run this version of posegaussian ({answer}); install the same version"
                    " there",
                )

    def _objection(self, worker: str, answer: Introduction) -> str | None:
        if answer.digest != self._build.digest:
            return self._other_code(worker, answer.versions)
        return (
            None
            if answer.sees
            else f"{worker} does not see the archive {self._archive}; mount it there at the same path"
        )

    def _other_code(self, worker: str, versions: dict[str, str]) -> str:
        return builds.objection(
            worker,
            versions,
            builds.EDITED if self._cluster is not None else "install the same there and start the worker again",
        )

    def _leave_out(self, address: str, why: str) -> None:
        if address not in self._unfit:
            self._unfit[address] = why
            self._news.append(f"{why}; it is given nothing")

    def news(self) -> list[str]:
        """What the user should know, since it was last asked for."""
        said, self._news = self._news, []
        return said

    def _sentence(self) -> str:
        cpu, gpu = self._workers.pools.get(CPU), self._workers.pools.get(GPU)
        seen = "" if self._cluster is None or visible_gpus() else ", on the CPU: no GPU is seen here"
        placed = (
            f"GPU work is pinned to {number(gpu.workers, 'GPU worker')}{seen}"
            if gpu
            else "no worker has a GPU: network, refinement and rendering run on the CPU workers"
        )
        return (
            f"running on {self._address or 'this machine'} with {number(cpu.workers if cpu else 0, 'CPU worker')};"
            f" {placed}"
        )

    @property
    def pools(self) -> dict[str, Pool]:
        """What the workers can serve."""
        return self._workers.pools

    def _look(self) -> None:
        """See which workers there are now, and which of them may be given something."""
        found = self._client.scheduler_info(n_workers=-1)["workers"]
        self._unfit = {a: why for a, why in self._unfit.items() if a in found}
        self._fit &= found.keys()
        if self._cluster is None:  # our own are asked by the tasks alone
            self._vet([a for a in found if a not in self._unfit and a not in self._fit])
        self._workers = _Workers.of(
            {a: w for a, w in found.items() if a not in self._unfit and (a in self._fit or self._cluster is not None)}
        )
        self._looked = time.monotonic()

    def _look_again(self) -> None:
        """Workers come and go: give what cannot run any more to others. Raises SchedulerLost or OtherCode when those
        that are needed stay away."""
        if not (self._cluster is None or self._unfit) or time.monotonic() - self._looked < LOOK_AGAIN:
            return
        self._connected()
        self._look()
        alive = frozenset[str]().union(*self._workers.addresses.values())
        for future in [f for f, flown in self._tasks.items() if flown.where and not flown.where & alive]:
            flown = self._tasks.pop(future)
            self._cancel([future])
            self._parked.append((flown.task, flown.order))
        parked, self._parked = self._parked, []
        for task, order in parked:
            self._place(task, order)
        self._served = self._served if self._parked else time.monotonic()
        if time.monotonic() - self._served > ABANDONED:
            self._give_up(f"for {ABANDONED:.0f} s")

    def _give_up(self, since: str) -> NoReturn:
        """Raise OtherCode or SchedulerLost: nobody is there for what is parked."""
        if self._unfit:
            raise OtherCode("no worker fits this run any more: " + "; ".join(self._unfit.values()))
        missing = " and no ".join(sorted({self.pool(order.gpu) for _, order in self._parked}))
        raise SchedulerLost(
            f"{self._address} has had no {missing} worker {since}; what is done is kept, start workers and run again"
        )

    def pool(self, gpu: int) -> str:
        """The GPU pool for what asks for a GPU, where there is one."""
        return pool_for(gpu, self._workers.pools)

    def free(self, pool: str) -> int:
        """Room in a pool's window."""
        self._look_again()
        workers = self._workers.pools[pool].workers if pool in self._workers.pools else 1
        taken = sum(f.pool == pool for f in self._tasks.values()) + sum(
            self.pool(order.gpu) == pool for _, order in self._parked
        )
        return workers * self._windows[pool].tasks - taken

    def _connected(self) -> None:
        """Wait for a lost connection to come back. Raises SchedulerLost."""
        end = time.monotonic() + RECONNECTION
        while self._client.status != "running":
            if self._client.status not in ("connecting", "newly-created") or time.monotonic() > end:
                raise SchedulerLost(
                    f"the scheduler {self._address or 'of this machine'} does not answer any more; what is done is"
                    " kept, run again"
                )
            time.sleep(0.1)

    def submit(self, task: Task, order: WorkOrder) -> None:
        """One future; the key groups by stage on Dask's dashboard. Raises SchedulerLost."""
        self._connected()
        self._place(task, order)

    def _place(self, task: Task, order: WorkOrder) -> None:
        """Hand a task to the scheduler for the workers of its pool; without any it waits for the next look.

        Our own workers are told apart by resources alone while all of them fit: a worker that is started anew has a new
        address.
        """
        pool = self.pool(order.gpu)
        where = self._workers.addresses[pool] if self._cluster is None or self._unfit else frozenset[str]()
        if pool not in self._workers.pools:
            self._parked.append((task, order))
            return
        self._attempts += 1
        resources = {GPU: order.gpu} if pool == GPU else {CPU: 1} if self._workers.tagged else None
        key = f"{task.stage}-{order.terms.run}-{self._attempts:08d}"
        future = self._client.submit(
            execute_packed,
            self._build.digest,
            pickle.dumps(order),
            key=key,
            pure=False,
            workers=sorted(where) or None,
            resources=resources,
        )
        self._tasks[future] = _Flown(task, order, pool, where)
        self._client.loop.add_callback(self._await, future)

    async def _await(self, future: Any) -> None:
        """Fetch a result on the client's own thread as soon as it is there: asked for by `next_done`, one after the
        other, fetching took longer than the work around a task."""
        try:
            outcome = await future
        except (Exception, asyncio.CancelledError) as e:
            outcome = e
        self._ended.put((future, outcome))

    def next_done(self, seconds: float | None = None) -> tuple[Task, Receipt | Failure] | None:
        """The next finished future, its result or its error; raises SchedulerLost when nobody answers any more,
        OtherCode when no worker fits."""
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            left = PATIENCE if end is None else min(PATIENCE, end - time.monotonic())
            try:
                future, outcome = self._ended.get(timeout=max(0.0, left))
            except queue.Empty:
                self._connected()
                self._look_again()
                if end is not None and time.monotonic() >= end:
                    return None
                continue
            flown = self._tasks.pop(future, None)
            if flown is None:
                continue  # it was given to another worker meanwhile
            if not isinstance(outcome, OtherCode):
                return flown.task, self._result(flown, future.status, outcome)
            self._refused(flown, outcome)

    def _result(self, flown: _Flown, status: str, outcome: Any) -> Receipt | Failure:
        if isinstance(outcome, bytes):
            receipt: Receipt = pickle.loads(outcome)
            self._windows[flown.pool].note(receipt.facts["seconds"])
            return receipt
        if status in ("cancelled", "lost"):
            return Failure("the connection to the scheduler was lost while it ran", kind=Kind.TRANSIENT)
        return death(flown.order) if type(outcome).__name__ == "KilledWorker" else failure(outcome)

    def _refused(self, flown: _Flown, by: OtherCode) -> None:
        """A worker is not of this build: the task goes to another one. Raises OtherCode when all of our own are like
        that."""
        who = f"worker {by.worker}"
        self._leave_out(by.worker, self._other_code(who, by.versions) if by.versions else f"{who}: {by}")
        self._look()
        self._place(flown.task, flown.order)
        if self._parked and self._cluster is not None and len(self._unfit) >= len(self._cluster.worker_spec):
            self._give_up("")

    def _cancel(self, futures: list[Any]) -> None:
        with suppress(OSError):  # a scheduler that is lost forgets them by itself
            self._client.cancel(futures, force=True)

    def close(self, hard: bool = False) -> None:
        """Cancel what is in flight and, for a cluster of our own, end its workers: at once where hard.

        What runs on an external scheduler's workers goes on to the end of its task, whose lease it holds until then.
        """
        if self._cluster is not None and hard:
            self.kill()
        if self._tasks and self._client.status == "running":
            self._cancel(list(self._tasks))
        with suppress(OSError):
            self._client.close(timeout=5)
        if self._cluster is not None:
            try:
                self._cluster.close(timeout=10)
            except TimeoutError:  # a machine with much else to do
                self.kill()

    def kill(self) -> None:
        """End our own workers in the middle of what they do; their leases end with them."""
        for nanny in self._cluster.workers.values() if self._cluster is not None else ():
            nanny.close_gracefully(reason="interrupted")  # or it would start a new worker
            if nanny.pid is not None:
                os.kill(nanny.pid, signal.SIGKILL)


def _connect(to: Any, address: str | None) -> Any:
    """A client of a cluster of our own, or of the scheduler at an address. Raises ConfigError when nobody answers
    there, or for tls:// without certificates."""
    from distributed import Client, Security

    for name in (
        "distributed",
        "distributed.client",
    ):  # what is lost is told by the run, with its sentence; Dask's own report would say it again with a traceback
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if address is not None and address.startswith("tls://"):
        try:
            context = Security().get_connection_args("client").get("ssl_context")
        except OSError as e:
            raise ConfigError(
                "run.scheduler: the certificates that Dask's configuration names in distributed.comm.tls cannot be"
                f" read ({e})"
            ) from e
        if context is None:
            raise ConfigError(
                f"run.scheduler: {address} needs certificates: name them in Dask's configuration,"
                " distributed.comm.tls.ca-file, .client.cert and .client.key, as docs/guide/runs.md shows"
            )
    try:
        return Client(to, timeout="5s", set_as_default=False)
    except OSError as e:
        raise ConfigError(
            f"run.scheduler: no scheduler answers at {address} ({e}); start one with `dask scheduler`, or use"
            " --scheduler local"
        ) from e
