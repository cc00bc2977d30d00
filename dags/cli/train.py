"""The command `posegaussian train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.cli.options import TrainingSetOption, say
from posegaussian.dags.export.output_paths import output_folder
from posegaussian.dags.humanize.text import next_command


def train(
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Configuration laid over the packaged default, dags/training/training.yaml."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            help=(
                "Folder of the training: log, checkpoints, frames, weights; default: training-NAME after the"
                " configuration's file, else training-default."
            ),
        ),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            "--minutes",
            help=(
                "Stop after so many minutes with a checkpoint;"
                " the same command goes on. Default: when all steps are done."
            ),
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
                "Processes that make frames ahead of the trainer, 0: it makes them itself; default: half of the cores,"
                " all of them where a GPU trains."
            ),
            min=0,
            max=256,
        ),
    ] = None,
    frames: Annotated[
        Path | None,
        typer.Option(
            "--frames",
            help="Folder for frames that several trainings share; default: frames in the folder of the training.",
        ),
    ] = None,
    device: Annotated[str, typer.Option("--device", help="auto (CUDA where there is a device), cpu or cuda.")] = "auto",
    assignments: TrainingSetOption = None,
) -> None:
    """Train the network on simulated people, or go on with a training that was stopped, killed or interrupted.

    Example: posegaussian train --config fast.yaml --minutes 30
    """
    from posegaussian.dags.training.config import load_training
    from posegaussian.dags.training.loop import TrainingOrder, chosen_device, cores
    from posegaussian.dags.training.loop import train as run
    from posegaussian.dags.training.run_folder import RunFolder
    from posegaussian.storage.model.errors import ConfigError

    if device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"--device {device}: auto, cpu or cuda")
    folder = output or Path(f"training-{config.stem if config else 'default'}")
    settings = load_training(config, assignments or [], folder)
    device = chosen_device(device)
    most = cores() if device == "cuda" else max(1, cores() // 2)
    own = most if workers is None else workers
    if output is not None:
        output_folder("train --output", output)
    run(
        TrainingOrder(settings, folder, frames, minutes, threads or max(1, cores() - own), own, device),
        lambda line: say([line]),
    )
    weights = RunFolder(folder).weights_file
    if weights.is_file():
        say([next_command("run", "--set", f"network.weights={weights}")])
