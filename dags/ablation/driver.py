"""Ablation: many short trainings, and runs of the pipeline, that differ in one thing each, cell by cell, and the tables
that come of them.

A cell is an ordinary training (`dags/training/loop.py`) in a folder of its own, over frames that all cells share, or a
run (`dags/ablation/pipeline_runs.py`); runs come last, because they may need what was trained. What is finished is
never done again, what is not goes on; the tables are written whatever ends a call.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from posegaussian.dags.ablation.cells import Cell, in_order, take
from posegaussian.dags.ablation.groups import Group, chosen
from posegaussian.dags.ablation.iterations import measure
from posegaussian.dags.ablation.pipeline_runs import RunCell, Weights, own_weights, run, runs_in_order, weights_of
from posegaussian.dags.ablation.tables import write
from posegaussian.dags.ablation.trained_runs import lpips_settings, picture_runs
from posegaussian.dags.humanize.text import number
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.training.frame_producers import FrameError
from posegaussian.dags.training.loop import PARTS, Parts, TrainingOrder, train
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.model.errors import UserError

Say = Callable[[str], None]


@dataclass(frozen=True)
class AblationOrder:
    """One call of `posegaussian ablate`."""

    config: TrainingConfig
    """What all cells have in common, the number of steps included."""
    folder: Path
    seeds: tuple[int, ...] = (0, 1, 2)
    only: tuple[str, ...] = ()
    """Groups that are worked on; empty: all."""
    frames: Path | None = None
    """Folder for frames that other trainings share, too; None: `frames` within the folder."""
    minutes: float | None = None
    """After which it ends in order; None: when all is done."""
    threads: int = 1
    workers: int = 1
    device: str = "auto"
    weights: str | None = None
    """Of the runs: weights that ship or a file; None: those of the default's training of the same seed where it is
    finished, else `fast`."""
    pictures: bool = True
    """Whether pictures are drawn with what was trained, by a run of each cell's weights."""
    lpips: tuple[Path, Path] | None = None
    """Official AlexNet files of LPIPS, network and linear layers; None: it is not measured."""

    @property
    def groups(self) -> tuple[Group, ...]:
        """Those that are worked on. Raises ConfigError for a name that is no group."""
        return chosen(self.config, self.only)

    def cells(self) -> list[Cell]:
        """In the order in which they are trained."""
        return in_order(self.config, self.groups, self.seeds, self.folder)

    def runs(self) -> list[RunCell]:
        """In the order in which they are run, after all trainings. Raises ConfigError for weights that are not there
        and seeds without a sequence."""
        metrics = lpips_settings(self.lpips)
        found = runs_in_order(self.groups, self.seeds, self.folder, metrics)
        if self.pictures:
            found += picture_runs(self.config, self.groups, self.seeds, self.folder, metrics)
        for run_cell in found:
            self.weights_of(run_cell)
            _ = run_cell.scene
        return found

    def weights_of(self, run_cell: RunCell) -> Weights | None:
        """What a run has for its network, as things stand; None while its own training is not finished."""
        if run_cell.config is not None:
            return own_weights(run_cell)
        return weights_of(self.weights, self.config, run_cell.seed, self.folder)

    def finished(self, job: Cell | RunCell) -> bool:
        """Whether there is nothing to do for it."""
        return job.result() is not None if isinstance(job, Cell) else job.finished(self.weights_of(job))


def plan_lines(order: AblationOrder) -> list[str]:
    """What a call would do, a line a cell in their order; nothing is trained or written."""
    cells, runs = order.cells(), order.runs()
    lines = [f"{c}: {c.state()}" for c in cells]
    for r in runs:
        weights = order.weights_of(r)
        told = f"with weights {weights.name}" if weights is not None else "after its training"
        lines.append(f"{r}: {'done' if r.finished(weights) else 'not run'}, {told}")
    open_cells, open_runs = ([job for job in jobs if not order.finished(job)] for jobs in (cells, runs))
    left = [f"{number(len(open_cells), 'training')} of {number(order.config.steps, 'step')}"] if cells else []
    left += [number(len(open_runs), "run")] if runs else []
    return [*lines, f"{' and '.join(left)} to do, {len(cells) + len(runs) - len(open_cells) - len(open_runs)} done"]


def ablate(order: AblationOrder, say: Say, parts: Parts | None = None) -> bool:
    """Train, run and measure what is missing, until all is done, the minutes are over or Ctrl-C; then the tables are
    written.

    Returns whether no cell failed; one that fails is said and left, and the next one begins.

    Raises:
        ConfigError: for groups, weights and sequences that there are not, and a folder that holds an ablation of
            another configuration.
        FrameError: for a frame that cannot be made: every cell needs it.
        KeyboardInterrupt: after Ctrl-C and the checkpoint of the cell in hand.
    """
    jobs: list[Cell | RunCell] = [*order.cells(), *order.runs()]
    take(order.folder, order.config)
    work = _Work(order, say, parts or PARTS)
    try:
        work.do(jobs)
    finally:
        tables = write(order.config, order.folder, order.seeds, work.failures)
        for line in tables:
            say(line)
    return not work.failures


class _Work:
    """One call: its clock and what failed in it."""

    def __init__(self, order: AblationOrder, say: Say, parts: Parts) -> None:
        self.order, self.say, self.parts = order, say, parts
        self.frames = order.frames or order.folder / "frames"
        self.deadline = time.monotonic() + 60.0 * order.minutes if order.minutes is not None else float("inf")
        self.failures: dict[str, str] = {}

    def do(self, jobs: Sequence[Cell | RunCell]) -> None:
        """All cells, each with what is measured on it."""
        limit(self.order.threads)
        sweeps = {
            c.folder
            for g in self.order.groups
            for c in in_order(self.order.config, [g], self.order.seeds, self.order.folder)
            if g.rows[0].iterations is not None
        }
        for i, job in enumerate(jobs):
            name = f"cell {i + 1} of {len(jobs)}, {job}"
            try:
                done = self._cell(job, name, job.folder in sweeps) if isinstance(job, Cell) else self._run(job, name)
            except FrameError:
                raise
            except UserError as e:
                self.failures[str(job)] = str(e)
                self.say(f"{job}: {e}")
                continue
            if not done:
                left = sum(not self.order.finished(j) for j in jobs)
                self.say(
                    f"the minutes are over, {number(left, 'cell')} of {len(jobs)} are left;"
                    " the same command goes on from here"
                )
                return

    def _run(self, job: RunCell, name: str) -> bool:
        """False where time ran out before it was done."""
        weights = self.order.weights_of(job)
        if job.finished(weights):
            return True
        if weights is None:
            self.say(f"{job}: its training is not finished, so nothing can be drawn with it")
            return True
        if not self._goes_on():
            return False
        self.say(f"{name}, with weights {weights.name}")
        return run(job, weights, self.order.threads, lambda line: self.say(f"  {line}"), self._goes_on)

    def _cell(self, cell: Cell, name: str, sweep: bool) -> bool:
        """False where time ran out before it was done."""
        if cell.result() is None:
            if not self._goes_on():
                return False
            self.say(name)
            minutes = (self.deadline - time.monotonic()) / 60.0 if self.order.minutes is not None else None
            order = self.order
            train(
                TrainingOrder(
                    cell.config, cell.folder, self.frames, minutes, order.threads, order.workers, order.device
                ),
                lambda line: self.say(f"  {line}"),
                self.parts,
            )
            if not cell.finish():
                return False
        if not sweep:
            return True
        return measure(
            cell,
            range(1, cell.config.iterations + 1),
            self.frames,
            self.parts,
            self.order.device,
            lambda line: self.say(f"  {cell}: {line}"),
            self._goes_on,
        )

    def _goes_on(self) -> bool:
        return time.monotonic() < self.deadline
