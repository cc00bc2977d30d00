"""Commands in processes of their own, and what they and all that they start take."""

from __future__ import annotations

import os
import resource
import subprocess
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from benchmarks.report import ROOT

PAUSE = 0.5
"""Seconds between two looks at the memory."""


@dataclass(frozen=True)
class Taken:
    """By a command with all processes below it."""

    seconds: float
    """By the clock."""
    cpu: float
    """Processor seconds."""
    memory: float
    """MB at the peak of all together: pages that several share count once where the system tells that (Linux)."""
    others: float
    """Cores that everything else on the machine kept busy meanwhile, on the mean."""


def environment() -> dict[str, str]:
    """This process's, in which Python finds this checkout from any folder."""
    path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH")) if p)
    return {**os.environ, "PYTHONPATH": path}


def watched(command: Sequence[str], folder: Path) -> Taken:
    """Run a command in a folder and watch it. Raises CalledProcessError, with what it said, where it fails."""
    busy, spent, begun = _busy(), _spent(), time.perf_counter()
    with (folder / "said.txt").open("w+") as said:
        process = subprocess.Popen(command, cwd=folder, env=environment(), stdout=said, stderr=subprocess.STDOUT)
        peaks, done = [0], threading.Event()
        watcher = threading.Thread(target=_watch, args=(process.pid, peaks, done))
        watcher.start()
        try:
            status = process.wait()
        finally:
            done.set()
            watcher.join()
        said.seek(0)
        if status:
            error = subprocess.CalledProcessError(status, command)
            error.add_note(said.read()[-4000:])
            raise error
    seconds, cpu = time.perf_counter() - begun, _spent() - spent
    return Taken(seconds, cpu, max(peaks) / 1e6, max(0.0, _busy() - busy - cpu) / seconds)


def _watch(pid: int, peaks: list[int], done: threading.Event) -> None:
    """Append what a process and those below it hold, bytes, until `done`."""
    while not done.wait(PAUSE if peaks[1:] else 0):
        try:
            root = psutil.Process(pid)
            peaks.append(sum(_held(p) for p in (root, *root.children(recursive=True))))
        except psutil.NoSuchProcess:
            return


def _held(process: psutil.Process) -> int:
    """Bytes; 0 of one that has just ended."""
    try:
        found = process.memory_full_info()
    except (psutil.NoSuchProcess, psutil.AccessDenied):
        return 0
    return int(getattr(found, "pss", found.rss))


def _spent() -> float:
    """Processor seconds of all processes below this one that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _busy() -> float:
    """Processor seconds that the machine's cores were busy since it started."""
    times = psutil.cpu_times()
    idle = times.idle + getattr(times, "iowait", 0.0)
    # On Linux a guest's time is part of `user`, and its nice time of `nice`.
    twice = getattr(times, "guest", 0.0) + getattr(times, "guest_nice", 0.0)
    return float(sum(times) - idle - twice)
