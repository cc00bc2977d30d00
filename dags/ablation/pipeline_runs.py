"""The runs of the pipeline on simulated sequences, one a seed: those behind the tables that are not trained, and those
that draw pictures with what was (`trained_runs.py`).

A run is one row with one seed, in `FOLDER/runs/GROUP=ROW/seed-N`. Its sequence is filmed once for all rows that share
it, in `FOLDER/sequences`, and removed when these are done; a run that was killed goes on after the last task that it
finished.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.ablation.cells import RESULT, Cell, as_json, cell
from posegaussian.dags.ablation.groups import Group, Row
from posegaussian.dags.humanize.text import number
from posegaussian.dags.runtime.signals import interruptible
from posegaussian.dags.training.run_folder import RunFolder, locked
from posegaussian.stages.network.asset import card_of, weights_digest
from posegaussian.stages.network.params import NetworkParams
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.files.write import make_folder, whole_file, write_atomically

SHIPPED = "fast"
"""Weights that a run has where neither a file is named nor the default is trained."""
JOINTS = "joints3d.npy"
UNREFINED = "refinement.steps=0"
"""Refinement evens out what a row changes before it, and takes longer than all of that."""


@dataclass(frozen=True)
class Weights:
    """What a run has for its network."""

    setting: str
    """Value of `network.weights`."""
    name: str
    """For the page."""
    sha256: str
    iterations: int
    """Value of `network.iterations`: the default, or the most that they were trained with."""


@dataclass(frozen=True)
class RunCell:
    """One row of a group with footage, with one seed."""

    group: Group
    row: Row
    seed: int
    root: Path
    """Of the ablation."""
    config: TrainingConfig | None = None
    """Of the ablation, where the row is a training and the run has its weights; None: the same weights for all rows."""
    metrics: tuple[str, ...] = ()
    """Settings of the pipeline that say what is measured besides the default."""

    def __str__(self) -> str:
        return f"{self.variant}, seed {self.seed}"

    @property
    def trained(self) -> Cell | None:
        """The training whose weights it has, if it has its own."""
        return None if self.config is None else cell(self.config, self.row, self.seed, self.root)

    @property
    def variant(self) -> str:
        """`tps=pairwise`."""
        return f"{self.group.name}={self.row.label.split()[0]}"

    @property
    def scene(self) -> Scene:
        """Its sequence. Raises ConfigError for a seed that has none."""
        assert self.group.footage is not None
        return self.group.footage.scene(self.seed, self.row.cameras)

    @property
    def sequence(self) -> Path:
        """Folder of the filmed sequence, while one of its rows is not done."""
        own = f"-{self.row.cameras}" if self.row.cameras else ""
        return self.root / "sequences" / f"{self.group.name}{own}-seed-{self.seed}"

    @property
    def beside(self) -> list[RunCell]:
        """It and the rows that share its sequence."""
        return [replace(self, row=r) for r in self.group.rows if r.cameras == self.row.cameras]

    def settings(self, weights: Weights) -> tuple[str, ...]:
        """Of the pipeline, but for the weights."""
        return (*self.row.pipeline, f"network.iterations={weights.iterations}")

    def finished(self, weights: Weights | None) -> bool:
        """Whether it was run with these weights on this sequence, and what is asked was measured; never without
        weights."""
        found, settings = self._read(self.row), self.settings(weights) if weights is not None else ()
        return (
            found is not None
            and weights is not None
            and (found["weights"]["sha256"], found["scene"]) == (weights.sha256, self.scene.model_dump(mode="json"))
            and tuple(found["settings"][: len(settings)]) == settings
            and set(self.metrics) <= set(found["settings"])
        )

    def result(self) -> dict[str, Any] | None:
        """What it found: `numbers`, `weights`, `scene`, `settings`; None while it is not run, or with other weights
        than its training's, or than the reference's of the same seed where it has none of its own."""
        found = self._read(self.row)
        if self.config is not None:
            return found if self.finished(own_weights(self)) else None
        reference = self._read(self.group.row(self.group.reference))
        alike = found is not None and (
            reference is None or reference["weights"]["sha256"] == found["weights"]["sha256"]
        )
        return found if alike else None

    def numbers(self, row: Row) -> dict[str, float | None] | None:
        """What it says to its row; None: nothing yet."""
        result = self.result()
        return result["numbers"] if result is not None else None

    def state(self) -> str:
        """`done`, `not run`, or that its weights are not the reference's."""
        if self.result() is not None:
            return "done"
        return f"run with other weights than {self.group.reference}" if self._read(self.row) is not None else "not run"

    def note(self, weights: Weights, numbers: dict[str, float | None]) -> None:
        """Write down what it found."""
        about = {
            "weights": {"name": weights.name, "sha256": weights.sha256},
            "scene": self.scene.model_dump(mode="json"),
            "settings": [*self.settings(weights), *self.metrics],
        }
        write_atomically(self._file(self.row), as_json({"numbers": numbers, **about}))

    def _file(self, row: Row) -> Path:
        return self.root / "runs" / replace(self, row=row).variant / f"seed-{self.seed}" / RESULT

    def _read(self, row: Row) -> dict[str, Any] | None:
        file = self._file(row)
        return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None


def runs_in_order(
    groups: Sequence[Group], seeds: Sequence[int], folder: Path, metrics: tuple[str, ...] = ()
) -> list[RunCell]:
    """All runs of the groups with footage: seed by seed, so that a sequence is there no longer than its rows need
    it; the reference first."""
    out = []
    for group in groups:
        if group.footage is not None:
            rows = sorted(group.rows, key=lambda r: r.label != group.reference)
            out += [RunCell(group, row, seed, folder, metrics=metrics) for seed in seeds for row in rows]
    return out


def weights_of(given: str | None, config: TrainingConfig, seed: int, folder: Path) -> Weights:
    """Those that are named, else those of the finished default of the seed, else those that ship.

    Raises ConfigError for a name that is neither weights that ship nor a file, and WeightsError for a file without a
    card.
    """
    trained = default_cell(config, seed, folder)
    if given is not None:
        file = Path(given)
        setting, name = (str(file.resolve()) if file.is_file() else given), given
    elif trained.result() is not None:
        setting, name = str(RunFolder(trained.folder).weights_file.resolve()), str(trained)
    else:
        setting = name = SHIPPED
    params = NetworkParams(weights=setting)
    return Weights(setting, name, weights_digest(params), min(params.iterations, card_of(params).iterations))


def own_weights(run_cell: RunCell) -> Weights | None:
    """Those that the row's training came to, with the T of the row or the most that was trained; None while it is not
    finished."""
    trained = run_cell.trained
    if trained is None or trained.result() is None:
        return None
    params = NetworkParams(weights=str(RunFolder(trained.folder).weights_file.resolve()))
    return Weights(
        params.weights, str(trained), weights_digest(params), run_cell.row.iterations or trained.config.iterations
    )


def default_cell(config: TrainingConfig, seed: int, folder: Path) -> Cell:
    """The training of the configuration as it stands."""
    return cell(config, Row("default"), seed, folder)


def run(cell: RunCell, weights: Weights, threads: int, say: Callable[[str], None], go_on: Callable[[], bool]) -> bool:
    """Film where it is not filmed, run, measure and note; False where `go_on` said no before all was done.

    Raises:
        RunFailed: where a task of the pipeline failed.
        UserError: where another process is at work on the same sequence.
        KeyboardInterrupt: after Ctrl-C.
    """
    from posegaussian.dags.ablation.measures import measured
    from posegaussian.dags.simulation.simulated_run import run_capture

    def look() -> None:
        if not go_on():
            raise _Over

    folder = cell.sequence
    with (
        locked(
            folder.with_suffix(".lock"),
            f"another ablation is at work on {folder}; wait for it or choose another --output",
        ),
        interruptible(say, lambda: None),
    ):
        try:
            look()
            held_out = _filmed(cell.scene, folder, threads, say)
            look()
            settings = (
                UNREFINED,
                *cell.settings(weights),
                *cell.metrics,
                held_out,
                f"network.weights={json.dumps(weights.setting)}",
            )
            results, seconds = run_capture(folder, settings, threads=threads, after_each=look)
        except _Over:
            return False
        numbers = measured(results, np.load(folder / JOINTS))
        cell.note(weights, numbers)
        say(
            f"{seconds.total():.0f} s of a core, "
            + ", ".join(f"{k} {v:.4g}" for k, v in numbers.items() if k in cell.group.shown and v is not None)
        )
        if all(c.finished(weights if c.config is None else own_weights(c)) for c in cell.beside):
            shutil.rmtree(folder)
    return True


class _Over(Exception):
    """There is no time left."""


def _filmed(scene: Scene, folder: Path, threads: int, say: Callable[[str], None]) -> str:
    """Film a sequence into `folder` if it is not there whole; the setting that keeps its held-out cameras aside."""
    from posegaussian.dags.simulation.simulated_run import film_capture, held_out_setting

    about, wanted = folder / "sequence.json", scene.model_dump(mode="json")
    if about.is_file() and (found := json.loads(about.read_text(encoding="utf-8")))["scene"] == wanted:
        return str(found["held_out"])
    say(
        f"filming {number(scene.frames, 'frame')} of seed {scene.seed}, {scene.motion.name}, with {scene.rig.cameras}"
        " cameras and 2 held out"
    )
    partial = folder.with_suffix(".partial")
    for old in (partial, folder):
        shutil.rmtree(old, ignore_errors=True)
    make_folder(partial)
    staged, truth = film_capture(scene, partial, threads)
    with whole_file(partial / JOINTS) as joints, open(joints, "wb") as f:
        np.save(f, truth["joints3d"][..., :3].astype(np.float64))
    held_out = held_out_setting(staged)
    write_atomically(partial / about.name, as_json({"scene": wanted, "held_out": held_out}))
    os.replace(partial, folder)
    return held_out
