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
            " Default: posegaussian, which is the configuration as it stands; of a table of the paper that compares"
            " methods also hull, ibr, 3dgs and pose_off.",
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
    paper: Annotated[
        str | None,
        typer.Option(
            "--paper",
            help="A table of the paper in its form, its printed numbers beside those measured here: table1, table2,"
            " table3, table4, fig5, runtime. On its data sets that are in the archive, and on simulated people, which"
            " are filmed where the archive has none.",
        ),
    ] = None,
    ablation: Annotated[
        Path | None,
        typer.Option(
            "--ablation",
            help="Folder of a `posegaussian ablate`, for table3, table4 and fig5. Default: ablation-default, where it"
            " is there.",
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
    Example: posegaussian evaluate --paper table2 --output evaluation
    """
    from posegaussian.dags.evaluation.asked import asked
    from posegaussian.dags.evaluation.evaluate import run_evaluate
    from posegaussian.dags.evaluation.methods import chosen
    from posegaussian.dags.reproduction.reproduce import Order, checked, reproduce
    from posegaussian.storage.model.errors import ConfigError

    if ablation is not None and paper is None:
        raise ConfigError(f"--ablation {ablation} goes with --paper table3, table4 or fig5; name one, or leave it out")
    output_folder("evaluate --output", output)
    some = chosen(methods if paper is None else checked(paper, methods))
    own = [*(assignments or [])]
    if measures is not None:
        own += asked(open_session(config, assignments, archive).configuration, measures)
    session = open_session(config, own, archive, scheduler, voice=voice(verbose, quiet))
    if paper is not None:
        raise typer.Exit(reproduce(session, Order(paper, sequences or [], some, ablation, output)))
    raise typer.Exit(run_evaluate(session, sequences or [], some, output))
