"""A Dask cluster of this machine, with its workers' processes and what they are started with."""

from __future__ import annotations

import logging
import os
import threading
from typing import Any

from posegaussian.dags.config.settings import RunSettings
from posegaussian.dags.planning.resources import CPU, GPU, cpu_workers, gpu_workers, local_pools
from posegaussian.dags.runtime import threads
from posegaussian.dags.runtime.signals import deaf, interruptible
from posegaussian.storage.model.errors import SchedulerLost

CONFIGURATION = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-ttl": (
        "30 minutes"
    ),  # a kernel that is being compiled may hold the interpreter for long
    "distributed.worker.daemon": True,
    "distributed.worker.memory.target": False,  # nothing is kept on workers that could be spilt,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,  # and a paused worker would wait for ever: over the limit it ends
    "distributed.worker.memory.terminate": 0.95,
    "logging.distributed": "critical",
}
"""What a cluster of our own is started with."""


ATTEMPTS = 3
"""Times a cluster is started before it is given up: a worker may be killed while it starts, for memory or by
accident."""


def start_local(settings: RunSettings) -> Any:
    """A cluster of this machine: one process a worker; a GPU worker sees one device alone.

    Raises SchedulerLost when its workers die while they start, every time, and KeyboardInterrupt after a Ctrl-C and
    when it stands: what has half begun Dask cannot close without a traceback.
    """
    stopped = threading.Event()
    with interruptible(lambda line: None, lambda: None, stopped.set):
        cluster = _attempt(settings, stopped)
    if not stopped.is_set():
        return cluster
    if cluster is not None:
        cluster.close(timeout=10)
    raise KeyboardInterrupt


def _attempt(settings: RunSettings, stopped: threading.Event) -> Any:
    """The cluster; None where its workers die and no other attempt is wanted any more. Raises SchedulerLost."""
    for _ in range(ATTEMPTS):
        try:
            return _start(settings)
        except (RuntimeError, OSError) as e:
            why = e
        if stopped.is_set():
            return None
    raise SchedulerLost(
        f"no workers could be started on this machine in {ATTEMPTS} attempts ({why}): they died while they started,"
        " perhaps for memory; use fewer run.workers, or --scheduler serial"
    ) from why


def _start(settings: RunSettings) -> Any:
    import dask
    from distributed import Nanny, Scheduler, SpecCluster

    # A failed task is reported by the run, with its sentence; Dask's own report would say it again with a traceback.
    common = {**threads.environment(settings.threads), "DASK_LOGGING__DISTRIBUTED": "critical"}
    dask.config.set({**CONFIGURATION, "distributed.nanny.pre-spawn-environ": {**common, **threads.allocator()}})
    logging.getLogger("distributed").setLevel(
        logging.CRITICAL
    )  # for good: while it closes, the cluster's own silence is over, and a late message ends in a traceback
    os.environ.setdefault(
        "PYTHONWARNINGS", "ignore::UserWarning:multiprocessing.resource_tracker"
    )  # it counts what killed workers leave
    pools = local_pools(settings)
    devices = {f"cpu-{i}": None for i in range(cpu_workers(settings))} | gpu_workers(settings)
    spec: dict[str, Any] = {}
    for name, device in devices.items():
        pool = CPU if device is None else GPU
        environment = {**common, "CUDA_VISIBLE_DEVICES": device or ""}
        options = {
            "name": name,
            "nthreads": 1,
            "memory_limit": pools[pool].ram,
            "resources": {pool: 1},
            "env": environment,
            "dashboard": False,
            "silence_logs": logging.CRITICAL,
        }
        spec[name] = {"cls": Nanny, "options": options}
    with deaf():  # the cluster's thread, which starts workers, later ones too, is begun here
        return SpecCluster(
            workers=spec,
            scheduler={
                "cls": Scheduler,
                "options": {"dashboard": False, "dashboard_address": "127.0.0.1:0", "host": "127.0.0.1"},
            },
            silence_logs=logging.CRITICAL,
        )
