"""The commands that look after an archive: verify, gc, reshard, accept."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from posegaussian.dags.cli.options import (
    ArchiveOption,
    ConfigOption,
    SequenceOption,
    SetOption,
    open_session,
    say,
    selected,
)
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.planning.selection import Selection


def verify(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="Remove the receipts of what is broken, so that the next run makes it anew, and delete left-overs.",
        ),
    ] = False,
) -> None:
    """Read everything again and compare it with its receipts: sizes, checksums, decoded contents; and source files with
    what was imported.

    Example: posegaussian verify --sequence balance --repair
    """
    from posegaussian.dags.maintenance.verify import verify as read_again

    session = open_session(config, assignments, archive)
    done = read_again(session, session.names(sequence or ()), repair)
    named = [word for glob in sequence or () for word in ("--sequence", glob)]
    say([next_command(*done.following, *named, *session.options)])
    raise typer.Exit(done.status)


def gc(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    apply: Annotated[bool, typer.Option("--apply", help="Delete; without it only say what could go.")] = False,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            "--kind", help="Only these kinds: arrays, paths, range, stages, strays, variants, runs (may be repeated)."
        ),
    ] = None,
) -> None:
    """Say what could be deleted under these settings, how many bytes, and what would have to be computed again; delete
    with --apply.

    Example: posegaussian gc --kind arrays --kind strays --apply
    """
    from posegaussian.dags.maintenance.garbage_collection import collect

    session = open_session(config, assignments, archive)
    failed, could_go = collect(session, sequence or (), kind or [], apply)
    if could_go and not apply:
        named = [("--sequence", glob) for glob in sequence or ()] + [("--kind", k) for k in kind or ()]
        say([next_command("gc", *(word for pair in named for word in pair), *session.options, "--apply")])
    else:
        say([next_command("status", *session.options)])
    raise typer.Exit(failed)


def reshard(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence.")],
    frames: Annotated[int, typer.Option("--frames", help="Frames of a partition.", min=1, max=4096)],
    path: Annotated[
        list[str] | None,
        typer.Option("--path", help="Camera paths to carry over instead of the configured ones (may be repeated)."),
    ] = None,
    give_up: Annotated[
        bool, typer.Option("--give-up", help="Let go of what is not fresh or not asked for; it cannot be carried over.")
    ] = False,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Cut a sequence into partitions of another length, without computing anything again.

    Example: posegaussian reshard balance --frames 4
    """
    from posegaussian.dags.maintenance.reshard import reshard as cut

    session = open_session(config, assignments, archive)
    name = session.one_name(sequence)
    say(cut(session.plan(name, Selection(), tuple(path or ())), frames, give_up))
    say([next_command("status", "--sequence", name, *session.options)])


def accept(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence; a pattern such as '*' takes several.")],
    stage: Annotated[
        str,
        typer.Argument(
            help="Name of the stage whose outputs are kept as they are; all: every stage, after another version."
        ),
    ],
    reason: Annotated[str, typer.Option("--reason", help="Why the change cannot matter; kept in the receipts.")],
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Keep a stage's outputs after a harmless change of its code, version or settings, instead of computing them again.

    Example: posegaussian accept balance depth --reason "renamed a variable"

    Example: posegaussian accept "*" all --reason "the modules moved, no result changed"
    """
    from posegaussian.dags.maintenance.accept import EVERY, accept_every
    from posegaussian.dags.maintenance.accept import accept as keep

    session = open_session(config, assignments, archive)
    if stage != EVERY:
        selected([stage], None, None)
    for name in session.names([sequence]):
        if stage == EVERY:
            say(accept_every(partial(session.plan, name, Selection()), reason))
        else:
            say(keep(session.plan(name, Selection()), stage, reason))
    say([next_command("plan", "--sequence", sequence, *session.options)])
