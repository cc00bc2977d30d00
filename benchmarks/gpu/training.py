"""Training for some minutes by `posegaussian train`, into a folder that the next call goes on with."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gpu.rows import Row, Setup
from posegaussian.dags.training.run_folder import RunFolder, read_rows

SMALLEST = ("scenes.count=1", "validation.count=1", "size=64", "crop=32", "batch=1", "window=1", "cameras=[4]")
SHORTEST = ("depth_steps=1", "joint_steps=1", "steps_per_frame=2", "validate_every=2", "checkpoint_every=2")
"""One step of each phase, where figures do not count."""


def rows(setup: Setup) -> Iterator[Row]:
    """Steps made in the minutes, and what one takes."""
    if not setup.minutes:
        yield Row("training", "", "not asked for (MINUTES=0)")
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "training" if setup.small else setup.training
        log = RunFolder(folder).log_file
        last = max((r["step"] for r in read_rows(log)), default=0)
        subprocess.run(command(setup, folder), check=True)
        made = [r for r in read_rows(log) if r["kind"] == "step" and r["step"] > last]
    if not made:
        yield Row("training", "", f"no step in {setup.minutes:g} minutes, which went into frames: give it more")
        return
    side = "preset fast, 8 pairs of 128 px"
    yield Row("training: steps made", side, float(len(made)), f"in {setup.minutes:g} min", setup.name)
    for key, unit in (("seconds step", "ms"), ("seconds examples", "ms")):
        median = float(np.median([r[key] for r in made]))
        yield Row(f"training: {key.removeprefix('seconds ')}, median", side, 1000 * median, unit, setup.name)
    yield Row("training: loss of the last steps, median", side, _loss(made), "")


def command(setup: Setup, folder: Path) -> list[str]:
    """`posegaussian train`, in this Python."""
    words = ["train", "--output", str(folder), "--device", setup.device.type]
    if setup.small:
        words += ["--workers", "0", *(w for s in (*SMALLEST, *SHORTEST) for w in ("--set", s))]
    else:
        words += ["--minutes", str(setup.minutes)]
    return [sys.executable, "-m", "posegaussian.dags.cli.app", *words]


def _loss(made: list[dict[str, Any]]) -> float:
    """A log has null where a number was not finite."""
    return float(np.median([r["loss"] if r["loss"] is not None else np.nan for r in made[-50:]]))
