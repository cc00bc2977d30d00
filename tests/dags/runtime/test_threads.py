"""One number of threads for every library, also for those that run already."""

from __future__ import annotations

import os
import subprocess
import sys

COMPILED_LATER = """
import numba
numba.set_num_threads(1)  # launches its threads
from posegaussian.dags.runtime.threads import limit
limit(1)
limit(2)
print(numba.njit(lambda x: x + 1)(1))
"""


def test_another_number_of_threads_does_not_keep_numba_from_compiling() -> None:
    """In a notebook a second run with other `run.threads`: numba refuses a variable that changed after its start."""
    environment = {**os.environ, "NUMBA_NUM_THREADS": "3"}
    done = subprocess.run(
        [sys.executable, "-c", COMPILED_LATER], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "2"
