"""Processes that need the same kernel at the same time: one compiles it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

SLOW = """
import time
from numba import njit
from numba.extending import intrinsic

@intrinsic
def number(typing):
    time.sleep(SECONDS)  # as long as a compilation takes
    def code(context, builder, signature, arguments):
        return context.get_constant(signature.return_type, 7)
    from numba import types
    return types.int64(), code

@njit(cache=True)
def inner():
    return number()

@njit(cache=True)
def outer(x):
    return inner() + x
"""
RUN = """
import sys
from numba.core import event
from slow import outer
from posegaussian.dags.compiling.kernels import compile_once
compile_once()
with event.install_recorder("numba:compile") as compiled:
    print("ready", flush=True)
    sys.stdin.readline()
    assert outer(1) == 8
    assert outer(1.5) == 8.5
print(sum(e.is_start for _, e in compiled.buffer))
"""


def start(folder: Path) -> subprocess.Popen[str]:
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}
    variables["NUMBA_CACHE_DIR"] = str(folder / "kernels")
    return subprocess.Popen(
        [sys.executable, "-c", RUN], env=variables, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )


def ready(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"


def go(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()


def test_of_processes_that_begin_together_one_compiles_and_the_others_load(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW.replace("SECONDS", "0.5"))
    processes = [start(tmp_path) for _ in range(3)]
    for p in processes:
        ready(p)
    for p in processes:
        go(p)
    counts = [int(p.communicate(timeout=120)[0]) for p in processes]
    assert sum(counts) == 3, "inner once, outer of an integer and of a real number"


def test_who_dies_over_a_kernel_leaves_it_to_the_next(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW.replace("SECONDS", "60"))
    dead = start(tmp_path)
    ready(dead)
    go(dead)
    deadline = time.monotonic() + 60
    while len(list((tmp_path / "kernels").glob("*/*.lock"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    dead.kill()
    dead.communicate()
    (tmp_path / "slow.py").write_text(SLOW.replace("SECONDS", "0"))
    after = start(tmp_path)
    ready(after)
    go(after)
    assert int(after.communicate(timeout=120)[0]) == 3


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_locks_nothing(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW.replace("SECONDS", "0"))
    (tmp_path / "kernels").mkdir(mode=0o500)
    process = start(tmp_path)
    ready(process)
    go(process)
    process.communicate(timeout=120)
    assert process.returncode == 0
