"""Pictures of what was trained: a run of the pipeline with the weights of every cell, on the seed's sequence."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from posegaussian.dags.ablation.cells import cell
from posegaussian.dags.ablation.groups import DRAWN, FOOTAGE, PICTURES, Group, Row
from posegaussian.dags.ablation.measures import LPIPS
from posegaussian.dags.ablation.pipeline_runs import RunCell
from posegaussian.stages.metrics.measures.lpips import FILES
from posegaussian.stages.metrics.params import DEFAULT
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.model.capture import SourceFile
from posegaussian.storage.model.errors import ConfigError

FEWEST_CAMERAS = 6
"""On the ring of the pictures: as few as the paper has."""


def picture_runs(
    config: TrainingConfig, chosen: Sequence[Group], seeds: Sequence[int], folder: Path, metrics: tuple[str, ...] = ()
) -> list[RunCell]:
    """A run for every row of the trained groups, each once, seed by seed, so that one sequence serves all rows."""
    rows: dict[str, Row] = {}
    for group in chosen:
        if group.footage is None:
            for row in group.rows:
                drawn = drawn_row(config, row)
                rows.setdefault(drawn.label, drawn)
    if not rows:
        return []
    group = _group(tuple(rows.values()))
    return [RunCell(group, row, seed, folder, config, metrics) for seed in seeds for row in group.rows]


def picture_run(config: TrainingConfig, row: Row, seed: int, folder: Path) -> RunCell:
    """The run that draws what a row's training of one seed came to."""
    drawn = drawn_row(config, row)
    return RunCell(_group((drawn,)), drawn, seed, folder, config)


def drawn_row(config: TrainingConfig, row: Row) -> Row:
    """A row of trainings as one of runs: the most iterations that were trained are those of no row in particular."""
    iterations = row.iterations if row.iterations != config.iterations else None
    label = cell(config, row, 0, Path()).variant + (f",T={iterations}" if iterations is not None else "")
    return Row(label, row.settings, iterations, cameras=ring(config))


def ring(config: TrainingConfig) -> int:
    """Cameras around the person: an even number whose neighbours stand no farther apart than any that were trained
    on."""
    least = max(FEWEST_CAMERAS, min(config.cameras))
    return least + least % 2


def lpips_settings(files: tuple[Path, Path] | None) -> tuple[str, ...]:
    """Settings of the pipeline that measure LPIPS, too, with the official AlexNet files: network and linear layers.
    Raises ConfigError for a file that is not there."""
    if files is None:
        return ()
    for file in files:
        if not file.is_file():
            raise ConfigError(
                f"--lpips: no file {file}; give the official AlexNet network and its linear layers, with a comma"
                " between (docs/reference/metrics.md says where they are from)"
            )
    named = dict(zip(FILES[LPIPS], files, strict=True))
    paths = {name: str(file.resolve()) for name, file in named.items()}
    digests = {name: SourceFile.of(file).sha256 for name, file in named.items()}
    return (
        f"metrics.measures={json.dumps([*DEFAULT, LPIPS])}",
        f"metrics.lpips_sha256={json.dumps(digests)}",
        f"metrics.lpips_weights={json.dumps(paths)}",
    )


def _group(rows: tuple[Row, ...]) -> Group:
    return Group(
        PICTURES,
        "Pictures of what was trained",
        rows,
        rows[0].label,
        "Each row has the weights of its own training.",
        footage=FOOTAGE[PICTURES],
        shown=DRAWN,
        compared=DRAWN,
    )
