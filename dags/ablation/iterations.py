"""One finished training, measured with every number of iterations:
no step is taken, its last checkpoint is looked at again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from posegaussian.dags.ablation.cells import Cell
from posegaussian.dags.training.frame_producers import ProducedFrames
from posegaussian.dags.training.loop import Parts, chosen_device, producers
from posegaussian.dags.training.state import unpacked
from posegaussian.stages.contract.declaration import resolve
from posegaussian.storage.archive.checkpoints import read_latest
from posegaussian.storage.model.errors import UserError

if TYPE_CHECKING:
    from posegaussian.stages.training.contract import Trainer


def measure(
    cell: Cell,
    wanted: range,
    frames: Path,
    parts: Parts,
    device: str,
    say: Callable[[str], None],
    go_on: Callable[[], bool],
) -> bool:
    """Validate a cell's averaged weights with each T of `wanted` that it was not yet; False where `go_on` said no
    before all were.

    Raises UserError where the cell's checkpoint is gone.
    """
    missing = [t for t in wanted if t not in cell.by_iterations()]
    if not missing:
        return True
    checkpoint, _ = read_latest(cell.folder / "checkpoints")
    if checkpoint is None or checkpoint.step != cell.config.steps:
        raise UserError(
            f"{cell.folder} has no checkpoint of step {cell.config.steps} to measure with another T; delete"
            f" {cell.folder} to train it again"
        )
    shown = ProducedFrames(
        cell.config, producers(cell.config, frames, parts, 0), lambda step: range(0), say
    ).of_validation(go_on)
    if shown is None:
        return False
    for t in missing:
        if not go_on():
            return False
        trainer: Trainer = resolve(parts.trainer)(
            cell.config.model_copy(update={"iterations": t}), chosen_device(device)
        )
        trainer.restore(unpacked(checkpoint.data))
        cell.note_iterations(t, trainer.validate(shown))
        say(f"validated with T = {t}")
    return True
