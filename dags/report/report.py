"""`posegaussian report`: gathers what an archive says of its sequences and writes the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from posegaussian.dags.humanize.text import gigabytes, number
from posegaussian.dags.provenance.builds import libraries
from posegaussian.dags.provenance.once import one_moment
from posegaussian.dags.report.account import Account, accounts
from posegaussian.dags.report.page import page
from posegaussian.dags.session.session import Session
from posegaussian.storage.files.write import write_atomically

MOST = 3
"""Sequences that were made with other settings of which the command tells how; the page tells of all."""


def write_report(session: Session, globs: Sequence[str], file: Path) -> list[str]:
    """Write the page of some sequences, all without globs; returns sentences: where it lies, its size, what was made
    with other settings, what next.

    Raises ArchiveError when a glob matches none.
    """
    said, told = written(session, globs, file)
    otherwise = [sentence for a in told for sentence in a.made_otherwise]
    left = otherwise[MOST:]
    more = [f"{number(len(left), 'more sequence')} made with other settings; the page says which"] if left else []
    command = next((command for a in told for command in a.retry), None)
    following = command or f"open {file} in a browser; it can be sent as it is"
    return [said, *otherwise[:MOST], *more, f"next: {following}"]


@one_moment()
def written(session: Session, globs: Sequence[str], file: Path) -> tuple[str, list[Account]]:
    """Write the page of some sequences, all without globs; returns where it lies, and what it says of each.

    Raises ArchiveError when a glob matches none.
    """
    told = list(accounts(session, session.names(globs)))
    text = page(session.archive.root.resolve().name, told, libraries()).encode("utf-8", "replace")
    write_atomically(file, text)
    return f"report: {number(len(told), 'sequence')} in {file.resolve()}, {gigabytes(len(text))}", told
