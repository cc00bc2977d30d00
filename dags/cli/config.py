"""The command `posegaussian config`."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from posegaussian.dags.cli.options import ConfigOption, SetOption, say
from posegaussian.dags.humanize.text import next_command


def config(
    config: ConfigOption = None,
    assignments: SetOption = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of a configuration instead, for editors.")
    ] = False,
) -> None:
    """Print the settings that hold here: the packaged ones, pipeline.yaml or --config over them, and --set on top.

    Example: posegaussian config --schema > pipeline.schema.json
    """
    from posegaussian.dags.config.schema import configuration_schema
    from posegaussian.dags.config.settings import load_configuration

    if schema:
        typer.echo(json.dumps(configuration_schema(), indent=1))
    else:
        typer.echo(load_configuration(config, assignments or ()).as_yaml(), nl=False)
    if sys.stdout.isatty():  # else the lines go to a file, or to a program
        following = ["config", "--schema"] if schema else ["plan"]
        say([next_command(*following) + (" > pipeline.schema.json" if schema else "")])
