"""The trainings behind an ablation's tables: which there are, in which order they are done, and what each one found.

A cell is one variant with one seed, a training of its own in `FOLDER/cells/VARIANT/seed-N`. Rows of several tables that
come to the same configuration are one cell. A cell with a `result.json` is finished; its checkpoints may be deleted.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import safe_open

from posegaussian.dags.ablation.groups import Group, Row
from posegaussian.dags.config.yaml_source import load
from posegaussian.dags.training.config import differences
from posegaussian.dags.training.run_folder import RunFolder, read_rows
from posegaussian.stages.network.card import read_card
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.archive.checkpoints import steps_kept
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.yaml_documents import yaml_text

Numbers = dict[str, float]
PLAIN = "default"
"""Name of the variant that is the configuration as it stands."""
RESULT, BY_ITERATIONS = "result.json", "iterations.json"
OWN = frozenset({"validate_every", "checkpoint_every", "seed"})
"""Settings that may differ between two calls in one folder; the seed is each cell's own."""


@dataclass(frozen=True)
class Cell:
    """One training."""

    variant: str
    """What sets it apart from the configuration, `fusion=gated`."""
    config: TrainingConfig
    """Its own, seed included."""
    folder: Path
    """Of its training."""

    def __str__(self) -> str:
        return f"{self.variant}, seed {self.config.seed}"

    def result(self) -> dict[str, Any] | None:
        """What it found: `numbers` of its last validation, `parameters`, `minutes`, `machine`, `steps`; None while
        it is not finished."""
        file = self.folder / RESULT
        return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None

    def state(self) -> str:
        """`done`, `step 20 of 60` or `not run`."""
        if self.result() is not None:
            return "done"
        kept = steps_kept(self.folder / "checkpoints")
        return f"step {kept[0]} of {self.config.steps}" if kept else "not run"

    def finish(self) -> bool:
        """Write down what it found, if its last step is done and validated."""
        run = RunFolder(self.folder)
        last = [r for r in read_rows(run.log_file) if r["kind"] == "validation" and r["step"] == self.config.steps]
        if not last or steps_kept(run.checkpoints)[:1] != [self.config.steps]:
            return False
        numbers = {k: v for k, v in last[-1].items() if k not in ("kind", "step")}
        card = read_card(run.weights_file)
        found = {
            "steps": self.config.steps,
            "numbers": numbers,
            "parameters": parameters(run.weights_file),
            "minutes": card.minutes,
            "machine": card.machine,
        }
        write_atomically(self.folder / RESULT, as_json(found))
        return True

    def by_iterations(self) -> dict[int, Numbers]:
        """{T: validation numbers} as far as they were measured."""
        file = self.folder / BY_ITERATIONS
        return (
            {int(t): numbers for t, numbers in json.loads(file.read_text(encoding="utf-8")).items()}
            if file.is_file()
            else {}
        )

    def note_iterations(self, iterations: int, numbers: Mapping[str, float]) -> None:
        """Add a T; what is not finite becomes null."""
        plain = {k: float(v) if math.isfinite(v) else None for k, v in numbers.items()}
        write_atomically(self.folder / BY_ITERATIONS, as_json({**self.by_iterations(), iterations: plain}))

    def numbers(self, row: Row) -> dict[str, float | None] | None:
        """What it says to a row of a table; None: nothing yet."""
        if row.iterations is not None:
            return dict(found) if (found := self.by_iterations().get(row.iterations)) is not None else None
        result = self.result()
        return result["numbers"] if result is not None else None


def cell(base: TrainingConfig, row: Row, seed: int, folder: Path) -> Cell:
    """The training behind a row; `folder` is the ablation's."""
    config = TrainingConfig.model_validate({**base.model_dump(), **row.settings, "seed": seed})
    plain = base.model_copy(update={"seed": seed})
    changed = {k: getattr(config, k) for k in TrainingConfig.model_fields if getattr(config, k) != getattr(plain, k)}
    variant = ",".join(f"{k}={_word(v)}" for k, v in changed.items()) or PLAIN
    return Cell(variant, config, folder / "cells" / variant / f"seed-{seed}")


def in_order(base: TrainingConfig, chosen: Sequence[Group], seeds: Sequence[int], folder: Path) -> list[Cell]:
    """All cells of some groups, each once: the table that needs the fewest trainings more comes first.

    Within a table the reference is first; a variant's seeds follow each other, so that what ends early has whole rows.
    """
    found: dict[str, list[Cell]] = {}
    waiting = {g.name: _variants(base, g, seeds, folder) for g in chosen if g.footage is None}
    while waiting:
        missing = {
            name: sum(c.result() is None for v, cells in of.items() if v not in found for c in cells)
            for name, of in waiting.items()
        }
        cheapest = min(waiting, key=lambda name: missing[name])  # the first one of equals: the order of the tables
        found |= {v: cells for v, cells in waiting.pop(cheapest).items() if v not in found}
    return [c for cells in found.values() for c in cells]


def _variants(base: TrainingConfig, group: Group, seeds: Sequence[int], folder: Path) -> dict[str, list[Cell]]:
    rows = sorted(group.rows, key=lambda r: r.label != group.reference)
    cells = [cell(base, row, seed, folder) for row in rows for seed in seeds]
    return {
        variant: list({c.config.seed: c for c in cells if c.variant == variant}.values())
        for variant in dict.fromkeys(c.variant for c in cells)
    }


def seeds_found(folder: Path) -> list[int]:
    """Seeds of all finished trainings and runs."""
    names = {f.parent.name for kind in ("cells", "runs") for f in folder.glob(f"{kind}/*/seed-*/{RESULT}")}
    return sorted(int(name.removeprefix("seed-")) for name in names)


def with_steps(config: TrainingConfig, steps: int | None) -> TrainingConfig:
    """The configuration with so many steps in all, shared between the phases as it has them. Raises ConfigError for
    what no ablation can train."""
    if config.start is not None:
        raise ConfigError(
            f"start is {config.start}: the cells of an ablation begin with random weights of their seed, or those that"
            " differ in shape could not be compared; leave it null"
        )
    if config.steps == 0:
        raise ConfigError("depth_steps and joint_steps are both 0: there is nothing to train")
    if steps is None:
        return config
    depth = round(steps * config.depth_steps / config.steps)
    return config.model_copy(update={"depth_steps": depth, "joint_steps": steps - depth})


def take(folder: Path, config: TrainingConfig) -> None:
    """Note what all cells of a folder have in common.
    Raises ConfigError where it holds an ablation of something else."""
    file = folder / "ablation.yaml"
    new = config.model_dump(mode="json")
    if file.is_file():
        changes = {k: c for k, c in differences(load(file).values, new).items() if k not in OWN}
        if changes:
            told = "; ".join(f"{k}: {c}" for k, c in changes.items())
            raise ConfigError(
                f"{folder} holds an ablation of another configuration ({told}); its cells could not be compared with"
                " new ones: take these back, or choose another --output"
            )
    write_atomically(file, yaml_text(new).encode())


def parameters(file: Path) -> int:
    """Floating numbers in a file of weights."""
    with safe_open(file, framework="numpy") as f:
        slices = [f.get_slice(k) for k in f.keys()]  # noqa: SIM118 (it is no mapping)
        return sum(math.prod(s.get_shape()) for s in slices if s.get_dtype().startswith(("F", "BF")))


def _word(value: Any) -> str:
    return (
        ("+".join(value) or "none")
        if isinstance(value, tuple)
        else f"{value:g}"
        if isinstance(value, float)
        else str(value)
    )


def as_json(value: Any) -> bytes:
    """Of plain data; raises ValueError for what is not finite."""
    return (json.dumps(value, indent=1, allow_nan=False) + "\n").encode()
