"""The command `posegaussian`: import, simulate, scans, plan, run, status, why, verify, gc, reshard, accept, evaluate,
tradeoff, effects, export, inspect, train, ablate, models, demo, doctor, config, init, report, view.

Exit status: 0 all done, 1 some partition failed, 2 usage or configuration, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from importlib.metadata import version
from typing import Annotated

import typer
from rich.markup import escape

from posegaussian.dags.cli.ablate import ablate
from posegaussian.dags.cli.config import config
from posegaussian.dags.cli.doctor import doctor
from posegaussian.dags.cli.evaluate import evaluate
from posegaussian.dags.cli.init import init
from posegaussian.dags.cli.inspect import inspect
from posegaussian.dags.cli.maintenance import accept, gc, reshard, verify
from posegaussian.dags.cli.models import models
from posegaussian.dags.cli.options import Commands, OfSequences, errors
from posegaussian.dags.cli.report import report, view
from posegaussian.dags.cli.results import effects, export, tradeoff
from posegaussian.dags.cli.run import plan, run, status, why
from posegaussian.dags.cli.sequences import ImportCommand, demo, import_capture, scans, simulate
from posegaussian.dags.cli.train import train
from posegaussian.dags.runtime.signals import sigterm_as_ctrl_c
from posegaussian.storage.files.write import FULL
from posegaussian.storage.model.errors import UserError

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Turn multi-view video of people into novel views: an incremental batch pipeline over chunked archives.",
)


def _say_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"posegaussian {version('posegaussian')}")
        raise typer.Exit


@app.callback()
def before_every_command(
    _: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say which version this is.")
    ] = False,
) -> None:
    """What may stand before a command's name."""


app.add_typer(models, name="models")
app.command("import", cls=ImportCommand)(import_capture)
app.command()(simulate)
app.command()(scans)
app.command(cls=OfSequences)(plan)
app.command(cls=OfSequences)(run)
app.command(cls=OfSequences)(status)
app.command()(why)
app.command(cls=OfSequences)(verify)
app.command(cls=OfSequences)(gc)
app.command()(reshard)
app.command()(accept)
app.command()(evaluate)
app.command(cls=OfSequences)(tradeoff)
app.command()(effects)
app.command()(export)
app.command()(inspect)
app.command()(report)
app.command()(view)
app.command()(train)
app.command()(ablate)
app.command()(demo)
app.command()(config)
app.command()(init)
app.command()(doctor)


def main() -> None:
    """Entry point: errors the user can mend are printed as sentences, without a traceback."""
    sigterm_as_ctrl_c()
    try:
        app()
    except UserError as e:
        for line in str(e).splitlines():  # indented lines are settings to copy, as they stand
            errors.print(escape(line) if line.startswith(" ") else f"[red]error:[/red] {escape(line)}", soft_wrap=True)
        sys.exit(2)
    except OSError as e:
        if e.filename is None and e.errno not in FULL:
            raise
        errors.print(
            f"error: {e.filename or 'standard output'}: {e.strerror}; choose another place, or free this one",
            style="red",
            markup=False,
            soft_wrap=True,
        )
        # what is left of the output would be tried once more at the end, and fail with a traceback
        if e.filename is None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(2)


if __name__ == "__main__":
    main()
