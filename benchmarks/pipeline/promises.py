"""What `run --budget` promises and what it keeps: seconds a frame asked for, chosen, expected and taken.

    python -m benchmarks.pipeline.promises [--frames 16] [--budgets 1 3 10 30] [--repeats 3] [--scenes 0 1 2 3]

Four people that no point of the front was chosen by, filmed by eight cameras of 512 px, six of 512, sixteen of 384 and
four of 640, two more held out and drawn. For each budget, in seconds a frame, settings are measured and chosen as `run
--budget` does it, then run as a command with two workers, from an empty archive to its end, starting and page included.
`measuring` is what choosing took, once. `others` says how many cores other work took during the run: near 0, or the
machine was not quiet. dB are box PSNR of the held-out pictures at full size.

`--search` runs every setting of `benchmarks/quality/front.py` instead, once, and prints what each takes and reaches, so
that the best within a budget is known.
"""

from __future__ import annotations

import argparse
import math
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pipeline.night import CLI
from benchmarks.processes import Taken, watched
from benchmarks.quality.cells import Cell
from benchmarks.quality.front import CANDIDATES, HALF, SMALLER
from benchmarks.report import show
from posegaussian.dags.budget.amount import Amount
from posegaussian.dags.budget.choice import Choice, affordable
from posegaussian.dags.diagnostics.held_out_quality import box_psnr
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.simulation.simulated_run import (
    ARCHIVE,
    NAME,
    film_capture,
    held_out_setting,
    registered,
    run_capture,
)
from posegaussian.stages.simulator.scene import Scene
from posegaussian.storage.model.errors import ConfigError

SCENES = (
    Cell(9006, 8),
    Cell(9106, None, scenes="capture_like"),
    Cell(9104, None, size=384, scenes="capture_like"),
    Cell(9103, None, size=640, scenes="capture_like"),
)
"""None of them is one of `benchmarks/quality/front.py`; frames are said by the command."""
WORKERS = 2
SHARES = {HALF: 0.5, SMALLER: 0.75}
"""Of the longest side, what sizes of the front are, whose people are filmed at 512 px."""
FILMED = frozenset({"survey", "judge", "detection", "tracks", "people", "pose", "frames"})
"""Stages up to the pictures that are compared with."""


@dataclass(frozen=True)
class Filmed:
    """A scene's capture in a folder."""

    folder: Path
    given: tuple[str, ...]
    """Settings of every run."""
    frames: int
    reference: Context
    """Of which the held-out cameras' pictures are there at full size."""

    @classmethod
    def of(cls, scene: Scene, folder: Path) -> Filmed:
        """Film it."""
        staged, _ = film_capture(scene, folder, WORKERS)
        given = (held_out_setting(staged), "run.scheduler=local", f"run.workers={WORKERS}", "run.threads=1")
        results, _ = run_capture(folder, given, Selection(only=FILMED), "reference")
        return cls(folder, given, scene.frames, results.context)

    def run(self, words: Sequence[str]) -> tuple[Taken, float]:
        """From an empty archive, which is removed, with further settings: what it took, and dB."""
        settings = (*self.given, *words)
        session = registered(self.folder, settings)
        chosen = [w for s in settings for w in ("--set", s)]
        taken = watched([*CLI, "run", "--archive", str(self.folder / ARCHIVE), *chosen], self.folder)
        psnr = box_psnr(session.plan(NAME, Selection()).context, self.reference)
        shutil.rmtree(self.folder / ARCHIVE)
        return taken, psnr

    def choice(self, amount: Amount) -> Choice:
        """What `run --budget` would run. Raises ConfigError where nothing is so cheap."""
        session = registered(self.folder, self.given)
        try:
            return affordable(session, [NAME], (), amount, Selection())
        finally:
            shutil.rmtree(self.folder / ARCHIVE)


def kept(filmed: Filmed, budget: float, repeats: int) -> dict[str, Any]:
    """A row: what was promised for a budget of seconds a frame, and what became of it."""
    begun = time.monotonic()
    try:
        choice = filmed.choice(Amount.of(f"{budget:g}s/frame"))
    except ConfigError as e:
        print(e, flush=True)
        unknown = dict.fromkeys(
            ("expected s", "took s", "took / expected", "dB", "measuring s", "others cores"), math.nan
        )
        return {"asked s": budget, "chosen": "nothing is so cheap", **unknown}
    measuring, expected = time.monotonic() - begun, choice.chosen.seconds / filmed.frames
    words = tuple(f"{k}={'null' if v is None else v}" for k, v in choice.chosen.values.items())
    runs = [filmed.run(words) for _ in range(repeats)]
    took = [taken.seconds / filmed.frames for taken, _ in runs]
    return {
        "asked s": budget,
        "chosen": choice.chosen.point.name,
        "expected s": expected,
        "took s": float(np.median(took)),
        "took / expected": float(np.median(took)) / expected,
        "dB": float(np.median([psnr for _, psnr in runs])),
        "measuring s": measuring,
        "others cores": float(np.median([taken.others for taken, _ in runs])),
    }


def searched(filmed: Filmed) -> list[dict[str, Any]]:
    """A row a setting of the front's candidates, run once."""
    rows = []
    for name, words in CANDIDATES.items():
        longest = int(filmed.reference.rig.size.max())
        taken, psnr = filmed.run([f"frames.size={round(SHARES[w] * longest)}" if w in SHARES else w for w in words])
        rows.append(
            {"settings": name, "took s": taken.seconds / filmed.frames, "dB": psnr, "others cores": taken.others}
        )
        show(rows[-1:])
    return rows


def main() -> None:
    """Print a table a scene as it is done."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--budgets", type=float, nargs="+", default=[1, 3, 10, 30])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--scenes", type=int, nargs="+", choices=range(len(SCENES)), default=list(range(len(SCENES))))
    parser.add_argument("--search", action="store_true")
    a = parser.parse_args()
    table: list[dict[str, Any]] = []
    for cell in (SCENES[i] for i in a.scenes):
        scene = cell.scene.model_copy(update={"frames": a.frames})
        of = {"seed": cell.seed, "cameras": scene.rig.cameras, "size": cell.size}
        with tempfile.TemporaryDirectory() as name:
            filmed = Filmed.of(scene, Path(name))
            rows = searched(filmed) if a.search else [kept(filmed, b, a.repeats) for b in a.budgets]
        table += [{**of, **row} for row in rows]
        show(table[-len(rows) :])


if __name__ == "__main__":
    main()
