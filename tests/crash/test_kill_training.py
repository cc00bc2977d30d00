"""kill -9 of a training at random moments, again and again: it ends with the bytes of an undisturbed one."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest

from posegaussian.storage.archive.checkpoints import steps_kept
from tests.dags.training.test_training import assert_alike, run, start

KILLS = 12


@pytest.mark.crash
@pytest.mark.timeout(1800)
def test_many_kills_of_a_training_leave_the_bytes_of_an_undisturbed_one(tmp_path: Path) -> None:
    run(tmp_path / "undisturbed")
    chance, killed, reached = random.Random(5), 0, 0
    folder = tmp_path / "killed"
    begin = time.monotonic()
    start(folder, 0.1, "--workers", "1", "--minutes", "0.05").communicate(timeout=120)
    idle = time.monotonic() - begin - 3.0
    while killed < KILLS:
        process = start(folder, 0.1, "--workers", "1")
        time.sleep(chance.uniform(0.5 * idle, idle + 3.0))
        if process.poll() is not None:
            break
        process.kill()
        process.wait()
        killed += 1
        kept = steps_kept(folder / "checkpoints")[:1] or [0]
        assert kept[0] >= reached, "a kill never costs a checkpoint that was there"
        reached = kept[0]
    assert killed >= 3, "the kills came too late to prove anything"
    run(folder)
    assert_alike(folder, tmp_path / "undisturbed")
    print(f"{killed} kills, the last at a checkpoint of step {reached}")
