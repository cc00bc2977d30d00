"""What a process spends once is timed apart from what a task does, whichever task comes first."""

from __future__ import annotations

import builtins
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from posegaussian.dags.compiling.warm_up import WARM_UP, steady_seconds, warm_up_timed, warming_up
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime import worker
from posegaussian.dags.runtime.meters import Stopwatch
from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.contract.io import Block
from posegaussian.stages.registry import stage
from posegaussian.storage.archive.receipts import scan_receipts
from tests.dags.compiling.test_kernels import SLOW
from tests.support.pipeline import Pipeline

RUN = """
import time
from slow import outer
from posegaussian.dags.compiling.kernels import compile_once
from posegaussian.dags.compiling.warm_up import warm_up_timed
from posegaussian.dags.runtime.meters import Stopwatch
compile_once()
for _ in range(2):
    timed = Stopwatch()
    with warm_up_timed(timed), timed("module"):
        assert outer(1) == 8
        time.sleep(0.1)
    print(timed.seconds.get("warm_up", 0.0), timed.seconds["module"])
"""


def test_the_seconds_of_compiling_are_those_of_no_module(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW.replace("SECONDS", "0.5"))
    variables = {"PYTHONPATH": ":".join([str(tmp_path), *filter(None, sys.path)])}
    variables["NUMBA_CACHE_DIR"] = str(tmp_path / "kernels")
    done = subprocess.run(
        [sys.executable, "-c", RUN], env=variables, text=True, capture_output=True, timeout=120, check=True
    )
    (first, module), (second, again) = [map(float, line.split()) for line in done.stdout.splitlines()]
    assert first >= 0.5 > second == 0
    assert 0.1 <= module < 0.5
    assert 0.1 <= again < 0.5


def test_a_library_that_is_imported_within_a_task_is_warming_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "slow_library_of_this_test.py").write_text("import time\ntime.sleep(0.2)\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    plain, spent = builtins.__import__, []
    for _ in range(2):
        timed = Stopwatch()
        with warm_up_timed(timed):
            import slow_library_of_this_test  # type: ignore[import-not-found]  # noqa: F401
        spent.append(timed.seconds.get(WARM_UP, 0.0))
    assert spent[0] >= 0.2
    assert spent[1] == 0
    assert builtins.__import__ is plain


def test_threads_that_warm_up_together_count_once() -> None:
    timed = Stopwatch()

    def work() -> None:
        with warming_up(), warming_up():
            time.sleep(0.2)

    threads = [threading.Thread(target=work) for _ in range(3)]
    with warm_up_timed(timed):
        for t in threads:
            t.start()
        for t in threads:
            t.join()
    assert 0.2 <= timed.seconds[WARM_UP] < 0.5
    with warming_up():
        pass
    assert timed.seconds[WARM_UP] < 0.5, "after the task nobody is told"


def test_the_receipt_of_a_task_tells_it(finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And its modules, where it names any, are without it."""
    kernel = resolve(stage("pose").run)

    def warming(*given: object) -> Iterator[Block]:
        with warming_up():
            time.sleep(0.3)
        yield from kernel(*given)

    monkeypatch.setattr(worker, "resolve", lambda where: warming if where == stage("pose").run else resolve(where))
    archive = finished.copy(tmp_path / "archive")
    archive.run(selection=Selection(force=frozenset({"pose"})))
    found = [r.facts for r in scan_receipts(archive.context().sequence) if r.stage == "pose"]
    assert len(found) == 3
    for facts in found:
        assert 0.3 <= facts[WARM_UP] <= facts["seconds"]
        assert steady_seconds(facts) == pytest.approx(facts["seconds"] - facts[WARM_UP])
        assert WARM_UP not in facts.get("modules", {})
