"""The command `posegaussian inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.cli.options import ArchiveOption, ConfigOption, SetOption, console, open_session, say
from posegaussian.dags.export.output_paths import output_folder
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.session.next_steps import first_look_command


def inspect(
    sequence: Annotated[str | None, typer.Argument(help="Name of the sequence.")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", help="Folder for the page and its pictures; default: inspect-SEQUENCE.")
    ] = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Say whether a capture is usable: calibration, pairs, joints, masks, light, timing and focus, as numbers, pictures
    and a page. Exit status 1: bad.

    Example: posegaussian inspect balance
    """
    from posegaussian.dags.inspection.inspect import run_inspection
    from posegaussian.dags.planning.context import Context

    if output is not None:
        output_folder("inspect --output", output)
    session = open_session(config, assignments, archive)
    name = session.one_name(sequence)
    # Not `session.context`: what a stage would refuse to work with is to be inspected all the same.
    context = Context(session.archive.sequence(name), session.configuration.for_sequence(name), ())
    bad = run_inspection(context, console, output)
    if bad:
        say([next_command("inspect", name, *session.options, lead="when that is mended")])
    else:
        say(first_look_command(session, name, context.capture, "a first look in minutes"))
        say([next_command("run", "--sequence", name, *session.options)])
    raise typer.Exit(bad)
