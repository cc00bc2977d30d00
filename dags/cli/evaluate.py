"""The command `posegaussian evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.cli.options import (
    ArchiveOption,
    ConfigOption,
    QuietOption,
    SchedulerOption,
    SetOption,
    VerboseOption,
    open_session,
    voice,
)
from posegaussian.dags.export.output_paths import output_folder


def evaluate(
    sequences: Annotated[
        list[str] | None,
        typer.Argument(help="Sequences to measure (names or globs). Default: all that have held-out cameras."),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            "--methods",
            help="Methods, with commas between: posegaussian, fast, dear, pose_off, hull, ibr, 3dgs."
            " Default: posegaussian, which is the configuration as it stands.",
        ),
    ] = None,
    measures: Annotated[
        str | None,
        typer.Option(
            "--measures",
            help="Further measures, with commas between: ms_ssim, flip, lpips_alex, lpips_vgg (`posegaussian models"
            " fetch lpips` brings their weights). Default: those of metrics.measures.",
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", help="Folder for the table as Parquet, Markdown and LaTeX.")
    ] = Path("evaluation"),
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    scheduler: SchedulerOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Measure rendered pictures against held-out cameras, ours and other methods', in one table: runs what is missing.

    Example: posegaussian evaluate walk --methods posegaussian,hull --output evaluation
    """
    from posegaussian.dags.evaluation.asked import asked
    from posegaussian.dags.evaluation.evaluate import run_evaluate
    from posegaussian.dags.evaluation.methods import chosen

    output_folder("evaluate --output", output)
    some = chosen(methods)
    own = [*(assignments or [])]
    if measures is not None:
        own += asked(open_session(config, assignments, archive).configuration.default.metrics, measures)
    session = open_session(config, own, archive, scheduler, voice=voice(verbose, quiet))
    raise typer.Exit(run_evaluate(session, sequences or [], some, output))
