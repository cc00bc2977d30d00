"""The sub-command `posegaussian models`: list, fetch, add."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.cli.options import say
from posegaussian.dags.humanize.text import next_command

models = typer.Typer(no_args_is_help=True, help="List, fetch or add other people's models, such as the pose estimator.")


@models.command("list")
def list_models() -> None:
    """Say which models are there, their sizes, what is missing and the command that brings it.

    Example: posegaussian models list
    """
    from posegaussian.dags.assets.downloads import listing
    from posegaussian.stages.estimators.blazepose_files import model_files

    following = ("models", "fetch", "blazepose") if model_files() is None else ("import", "auto", "FOLDER")
    say([*listing(), next_command(*following)])


@models.command()
def fetch(name: Annotated[str, typer.Argument(help="blazepose or lpips")]) -> None:
    """Bring a model's files from the package index, networks of LPIPS from torchvision's server, checked by their
    sha256, into the cache folder.

    Example: posegaussian models fetch blazepose
    """
    from posegaussian.dags.assets.downloads import fetch as bring

    following = ("evaluate", "--measures", "lpips_alex") if name == "lpips" else ("import", "auto", "FOLDER")
    say([*bring(name), next_command(*following)])


@models.command()
def add(
    files: Annotated[
        list[Path],
        typer.Argument(
            help=(
                "The mediapipe 0.10.21 or lpips 0.1.4 wheel, .tflite files of BlazePose, .pth files of LPIPS,"
                " or descriptions (.yaml) of ONNX models to check."
            )
        ),
    ],
) -> None:
    """Take models from files you have; nothing is downloaded.

    Example: posegaussian models add mediapipe-0.10.21-cp311-cp311-manylinux_2_28_x86_64.whl
    """
    from posegaussian.dags.assets.downloads import add as take

    say([*take(files), next_command("models", "list")])
