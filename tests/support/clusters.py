"""Schedulers and workers of others: processes that a test starts and ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from distributed import Client


def process(*words: str, code: Path | None = None) -> subprocess.Popen:
    """A Dask command as a process of its own, with the packages of another folder than the repository's."""
    folder = code or Path.cwd()
    environment = {**os.environ, "PYTHONPATH": str(folder), "DASK_DISTRIBUTED__WORKER__DAEMON": "True"}
    return subprocess.Popen(
        [sys.executable, "-m", *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,
    )


@contextmanager
def ending(started: subprocess.Popen) -> Iterator[subprocess.Popen]:
    try:
        yield started
    finally:
        if started.poll() is None:
            os.killpg(started.pid, signal.SIGKILL)
            started.wait()


class Cluster:
    """A scheduler and its workers, each a process."""

    def __init__(self, stack: ExitStack, file: Path, *options: str) -> None:
        """`options`: given to the scheduler and to every worker."""
        self.stack, self.file, self.options = stack, file, options
        words = [
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            str(file),
            *options,
        ]
        self.scheduler = stack.enter_context(ending(process(*words)))
        self.workers = 0

    def add(self, name: str, *options: str, code: Path | None = None) -> None:
        """Start a worker."""
        words = [
            "distributed.cli.dask_worker",
            "--scheduler-file",
            str(self.file),
            "--nthreads",
            "1",
            "--no-dashboard",
            "--no-nanny",
            "--name",
            name,
        ]
        self.stack.enter_context(ending(process(*words, *self.options, *options, code=code)))
        self.workers += 1

    def address(self) -> str:
        """Where the scheduler listens, once all workers are there."""
        with Client(scheduler_file=str(self.file), timeout="60s", set_as_default=False) as client:
            client.wait_for_workers(self.workers, timeout=60)
            return str(client.scheduler.address)
