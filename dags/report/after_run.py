"""The page that a run writes of its archive when it has ended, as `run.report` says."""

from __future__ import annotations

from pathlib import Path

from posegaussian.dags.export.output_paths import output_file
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.session.session import Session

NAME = "report.html"
"""Of the page in the archive's folder."""
EACH = 1.0
"""Seconds that a sequence takes on the page, generously: 0.4 were measured of small pictures, and the first one of a
process waits for imports."""
SHARE = 0.1
"""Of a run's seconds that its page may take unasked: touching one sequence of a hundred does not wait for the others'
pictures."""


def check(session: Session) -> None:
    """Raise ConfigError, before anything is computed, for a file of `run.report` that cannot be written."""
    wanted = session.configuration.default.run.report
    if wanted not in ("auto", "off"):
        output_file("run.report:", Path(wanted), (".html", ".htm"))


def tell(session: Session, seconds: float) -> None:
    """Write the page after a run of so many seconds, where it is wanted, and say where it lies.

    A page that cannot be made is a sentence: what was computed is there without it.
    """
    from posegaussian.dags.report.report import written

    wanted = session.configuration.default.run.report
    if wanted == "off":
        return
    unasked = wanted == "auto"
    file = session.archive.root / NAME if unasked else Path(wanted)
    again = next_command("report", *session.options, "--page", str(file), lead="to write it")
    if unasked and EACH * len(session.archive.names()) > SHARE * seconds:
        if file.is_file():
            session.hint([f"report: {file} is older than this run; {again}"])
        return
    try:
        said, _ = written(session, [], file)
    except Exception as e:  # whatever it is, the run has ended well or badly before, and its status says which
        session.say([f"report: {file} was not written: {e or type(e).__name__}; {again}"], "yellow")
        return
    session.hint([said])
