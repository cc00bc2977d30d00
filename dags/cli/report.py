"""The commands that show an archive in a browser: report, view."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from posegaussian.dags.cli.options import ArchiveOption, ConfigOption, SetOption, open_session, say
from posegaussian.dags.export.output_paths import output_file
from posegaussian.dags.humanize.text import next_command, number
from posegaussian.storage.model.errors import ConfigError


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


def view(
    folder: Annotated[
        str | None,
        typer.Argument(metavar="[ARCHIVE]", help="Folder of the archive. Default: `archive` of the configuration."),
    ] = None,
    sequences: Annotated[
        list[str] | None, typer.Argument(help="Sequences to show (names or globs). Default: all.")
    ] = None,
    archive: Annotated[
        str | None, typer.Option("--archive", help="The folder of the archive by an option, as other commands take it.")
    ] = None,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen on; 0.0.0.0 lets the whole network look.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", help="Port to listen on; 0 takes a free one.", min=0, max=65535)
    ] = 8765,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Show the person in a browser while an archive is being computed: finished frames appear as they come. Nothing is
    computed or written; Ctrl-C ends it.

    Example: posegaussian view archive walk
    """
    from posegaussian.dags.view.live import LiveSequences
    from posegaussian.dags.view.server import Server

    if folder is not None and archive is not None:
        instead = " ".join(quote(word) for word in (archive, *(sequences or [folder])))
        raise ConfigError(
            f"view {folder} --archive {archive}: the archive is named twice; name it before the sequences alone, for"
            f" example `posegaussian view {instead}`"
        )
    session = open_session(config, assignments, archive or folder)
    names = tuple(session.names(sequences or []))
    with Server(LiveSequences(session, names), host, port) as server:
        if not server.local:
            say([f"warning: --host {host}: anyone on the network can see this archive until it ends"], style="yellow")
        try:
            say([f"view: {number(len(names), 'sequence')} at {server.url}; open it in a browser, Ctrl-C ends it"])
            server.serve_forever(poll_interval=0.1)
        except KeyboardInterrupt:
            words = ("export", names[0], "--page", "person.html", *session.options)
            say([next_command(*words, lead="ended; for a file to send round, next")])
