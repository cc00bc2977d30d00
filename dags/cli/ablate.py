"""The command `posegaussian ablate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.cli.options import TrainingSetOption, say
from posegaussian.dags.export.output_paths import output_folder


def ablate(
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            help="Configuration of the trainings, laid over the packaged default, dags/training/training.yaml.",
        ),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            "--only",
            help=(
                "Groups, with commas between: fusion, pose, lambda, beta_gamma,"
                " iterations, heads, encoders, tps, cameras. Default: all."
            ),
        ),
    ] = None,
    seeds: Annotated[
        str, typer.Option("--seeds", help="Seeds of every cell, with commas between; fewer than 3 are no claim.")
    ] = "0,1,2",
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            help="Steps of every cell, shared between the phases as the configuration has them; default: its own.",
            min=1,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            help=(
                "Folder of the tables and of all trainings; default: ablation-NAME after the configuration's file, else"
                " ablation-default."
            ),
        ),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            "--minutes",
            help="End in order after so many minutes; the same command goes on. Default: when all is done.",
            min=0.05,
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            "--threads", help="Threads of the trainer; default: the cores that --workers leave.", min=1, max=256
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            help=(
                "Processes that make frames ahead of the trainer, 0: it makes them itself; default: half of the cores."
            ),
            min=0,
            max=256,
        ),
    ] = None,
    frames: Annotated[
        Path | None,
        typer.Option(
            "--frames",
            help="Folder for frames that other trainings share, too; default: frames in the folder of the ablation.",
        ),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            "--weights",
            help=(
                "Of the runs of tps and cameras: weights that ship, or a .safetensors file. Default: those that the"
                " default of the same seed was trained to, where it is finished, else fast."
            ),
        ),
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option(
            "--pictures/--no-pictures",
            help="Draw held-out views with every training's weights, a run of the pipeline each, and measure them.",
        ),
    ] = True,
    lpips: Annotated[
        str | None,
        typer.Option(
            "--lpips",
            help="Measure LPIPS, too, with the official AlexNet files: NETWORK,LINEAR (docs/reference/metrics.md).",
        ),
    ] = None,
    device: Annotated[str, typer.Option("--device", help="auto (CUDA where there is a device), cpu or cuda.")] = "auto",
    plan: Annotated[
        bool,
        typer.Option(
            "--plan", help="Say which cells there are, in their order, and what is done; train and write nothing."
        ),
    ] = False,
    assignments: TrainingSetOption = None,
) -> None:
    """Train variants of the network, and run the pipeline in variants, a cell at a time, and print what each choice is
    worth beside the paper's numbers.

    Example: posegaussian ablate --config fast.yaml --only fusion,pose --steps 600 --minutes 60
    """
    from posegaussian.dags.ablation.cells import with_steps
    from posegaussian.dags.ablation.driver import AblationOrder, plan_lines
    from posegaussian.dags.ablation.driver import ablate as run
    from posegaussian.dags.training.config import load_training
    from posegaussian.dags.training.loop import cores
    from posegaussian.storage.model.errors import ConfigError

    if device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"--device {device}: auto, cpu or cuda")
    settings = with_steps(load_training(config, assignments or []), steps)
    own = max(1, cores() // 2) if workers is None else workers
    if output is not None:
        output_folder("ablate --output", output)
    folder = output or Path(f"ablation-{config.stem if config else 'default'}")
    names = tuple(name.strip() for name in only.split(",")) if only else ()
    order = AblationOrder(
        settings,
        folder,
        _seeds(seeds),
        names,
        frames,
        minutes,
        threads or max(1, cores() - own),
        own,
        device,
        weights,
        pictures,
        _two_files(lpips),
    )
    if plan:
        say(plan_lines(order))
    elif not run(order, lambda line: say([line])):
        raise typer.Exit(1)


def _two_files(text: str | None) -> tuple[Path, Path] | None:
    from posegaussian.storage.model.errors import ConfigError

    if text is None:
        return None
    names = [part.strip() for part in text.split(",")]
    if len(names) != 2:
        raise ConfigError(f"--lpips {text}: {len(names)} of the two files NETWORK,LINEAR, with a comma between")
    return Path(names[0]), Path(names[1])


def _seeds(text: str) -> tuple[int, ...]:
    from posegaussian.storage.model.errors import ConfigError

    parts = [part.strip() for part in text.split(",")]
    if wrong := [p for p in parts if not p.isdecimal() or int(p) >= 2**31]:
        raise ConfigError(
            f"--seeds {text}: {wrong[0]!r} is no seed; whole numbers from 0 to 2147483647 with commas between"
        )
    return tuple(dict.fromkeys(int(p) for p in parts))
