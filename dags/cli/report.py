"""The command `posegaussian report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.cli.options import ArchiveOption, ConfigOption, SetOption, open_session, say
from posegaussian.dags.export.output_paths import output_file


def report(
    sequences: Annotated[
        list[str] | None, typer.Argument(help="Sequences to show (names or globs). Default: all.")
    ] = None,
    page: Annotated[Path, typer.Option("--page", help="HTML file to write.")] = Path("report.html"),
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Write one HTML file that shows every sequence: pictures that play, measures, reasons, seconds, failures. Nothing
    is computed.

    Example: posegaussian report --page report.html
    """
    from posegaussian.dags.report.report import write_report

    output_file("report --page", page, (".html", ".htm"))
    say(write_report(open_session(config, assignments, archive), sequences or [], page))
