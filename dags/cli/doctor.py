"""The command `posegaussian doctor`."""

from __future__ import annotations

import json as text

import typer

from posegaussian.dags.cli.options import ArchiveOption, ConfigOption, JsonOption, SetOption, open_session, say


def doctor(
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Say what this machine can do for a run, and the command that mends what it lacks. Exit status 1: no run is
    possible.

    Example: posegaussian doctor
    """
    from posegaussian.dags.diagnostics.doctor import examined, possible, sentences

    session = open_session(config, assignments, archive, machine=json)
    checks = examined(session.archive_url, session.configuration.default.metrics)
    if json:
        for check in checks:
            print(text.dumps(check.to_json()))
    else:
        say(sentences(checks))
    raise typer.Exit(0 if possible(checks) else 1)
