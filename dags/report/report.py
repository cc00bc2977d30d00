"""`posegaussian report`: gathers what an archive says of its sequences and writes the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from posegaussian.dags.humanize.text import gigabytes, number
from posegaussian.dags.provenance.builds import libraries
from posegaussian.dags.provenance.once import one_moment
from posegaussian.dags.report.account import accounts
from posegaussian.dags.report.page import page
from posegaussian.dags.session.session import Session
from posegaussian.storage.files.write import write_atomically


def write_report(session: Session, globs: Sequence[str], file: Path) -> list[str]:
    """Write the page of some sequences, all without globs; returns sentences: where it lies, its size, what next.

    Raises ArchiveError when a glob matches none.
    """
    said, commands = written(session, globs, file)
    following = commands[0] if commands else f"open {file} in a browser; it can be sent as it is"
    return [said, f"next: {following}"]


@one_moment()
def written(session: Session, globs: Sequence[str], file: Path) -> tuple[str, list[str]]:
    """Write the page of some sequences, all without globs; returns where it lies, and the commands that do again what
    failed.

    Raises ArchiveError when a glob matches none.
    """
    told = list(accounts(session, session.names(globs)))
    text = page(session.archive.root.resolve().name, told, libraries()).encode("utf-8", "replace")
    write_atomically(file, text)
    said = f"report: {number(len(told), 'sequence')} in {file.resolve()}, {gigabytes(len(text))}"
    return said, list(dict.fromkeys(command for a in told for command in a.retry))
