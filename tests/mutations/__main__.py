"""Break what the hard cases guard, one line at a time, each in a process of its own: the case must fail.

    python -m tests.mutations [CASE ...]

prints a line a guard: the case, the guarded line, and whether it was caught; fails where one was not. Nothing on the
disk is changed; kernels are compiled into a folder that is deleted, with few optimisations: that is
quicker, and the cases hold all the same.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from tests.mutations.guard import ROOT, Guard
from tests.mutations.registry import GUARDS

PROCESSES = 2
PATIENCE = 900
"""Seconds after which a case counts as not caught: a loop without an end."""


def tried(case: str, number: int) -> tuple[bool, str]:
    """Whether the case caught its guard's absence, and what it made of it."""
    guard = GUARDS[case][number]
    command = [sys.executable, "-m", "tests.mutations.one", case, str(number)]
    with tempfile.TemporaryDirectory() as kernels:
        own = {"NUMBA_CACHE_DIR": kernels, "NUMBA_OPT": "1"} if guard.compiled else {}
        try:
            done = subprocess.run(
                command,
                cwd=ROOT,
                env={**os.environ, **own},
                capture_output=True,
                text=True,
                timeout=PATIENCE,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return False, f"no answer within {PATIENCE} s"
    if done.returncode < 0:
        return True, f"the process ends by signal {-done.returncode}"
    if done.returncode:
        return False, f"nothing was tried: {(done.stderr.strip().splitlines() or ['no word'])[-1]}"
    return verdict(json.loads(done.stdout.splitlines()[-1]))


def verdict(found: dict[str, object]) -> tuple[bool, str]:
    """Whether that is a failure of the case, and in words."""
    if "broken" in found:
        return False, f"nothing was tried: {found['broken']}"
    if "raised" in found:
        return True, f"raises {found['raised']}"
    error, bound = float(str(found["error"])), float(str(found["bound"]))
    return not error <= bound, f"error {error:.3g}, bound {bound:.3g}"


def lines(cases: list[str]) -> Iterator[tuple[bool, str]]:
    """(caught, a line of the table) a guard, in the order of the catalogue."""
    chosen = [(case, n) for case in cases for n in range(len(GUARDS[case]))]
    with ThreadPoolExecutor(PROCESSES) as pool:
        for (case, n), (caught, told) in zip(chosen, pool.map(lambda one: tried(*one), chosen), strict=True):
            yield caught, _line(GUARDS[case][n], caught, told)


def _line(guard: Guard, caught: bool, told: str) -> str:
    return f"{guard.case:5}{'caught' if caught else 'NOT CAUGHT':11}{told:44}{guard.name}"


def main() -> None:
    unknown = [name for name in sys.argv[1:] if name not in GUARDS]
    if unknown:
        raise SystemExit(f"no case is called {', '.join(unknown)}; there are {', '.join(GUARDS)}")
    all_caught, count = True, 0
    for caught, line in lines(sys.argv[1:] or list(GUARDS)):
        print(line, flush=True)
        all_caught, count = all_caught and caught, count + 1
    if not all_caught:
        raise SystemExit("a case does not notice that what it guards is broken: sharpen what it measures")
    print(f"{count} guards of {len(sys.argv[1:]) or len(GUARDS)} cases, every one caught")


if __name__ == "__main__":
    main()
