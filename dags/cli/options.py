"""What the commands of `posegaussian` share:
their options, the session these lead to, and how sentences are printed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperCommand, TyperGroup

from posegaussian.dags.humanize.text import Voice
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.signals import STATUS as INTERRUPTED
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.home import word_at_home

console = Console(highlight=False)
errors = Console(stderr=True, highlight=False)


class Commands(TyperGroup):
    """The commands, in whose words `~` is the home folder even where quotes kept it from the shell, and which say that
    they were interrupted."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The words for the command that is named."""
        return super().parse_args(ctx, [word_at_home(a) for a in args])

    def invoke(self, ctx: Any) -> Any:
        """Do what the command does: here because Typer ends at a KeyboardInterrupt without a word."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            errors.print("interrupted; what is done is kept, the next run goes on from here")
            raise typer.Exit(INTERRUPTED) from None


class OfSequences(TyperCommand):
    """A command that works on all sequences, or on those named by --sequence: a name without it is told so."""

    allow_extra_args = True

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the words. Raises ConfigError where some are left."""
        rest = super().parse_args(ctx, args)
        if ctx.args:
            raise ConfigError(
                f"{ctx.info_name} {' '.join(ctx.args)}: a sequence is named by an option here; write"
                f" --sequence {quote(ctx.args[0])}"
            )
        return rest


ArchiveOption = Annotated[
    str | None, typer.Option("--archive", help="Folder of the archive; default: `archive` of the configuration.")
]
ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", help="Configuration laid over the packaged default; default: ./pipeline.yaml where it exists."
    ),
]
SequenceOption = Annotated[
    list[str] | None,
    typer.Option("--sequence", help="Sequences to work on (a name or glob; may be repeated). Default: all."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", help="Override one setting, for example --set depth.method=hull (may be repeated)."),
]
TrainingSetOption = Annotated[
    list[str] | None,
    typer.Option("--set", help="Override one setting of the training, for example --set seed=1 (may be repeated)."),
]
OnlyOption = Annotated[list[str] | None, typer.Option("--only", help="Touch these stages alone.")]
FromOption = Annotated[str | None, typer.Option("--from", help="Rerun this stage and every later one, fresh or not.")]
ForceOption = Annotated[list[str] | None, typer.Option("--force", help="Rerun these stages even where they are fresh.")]
PathOption = Annotated[
    list[str] | None,
    typer.Option(
        "--path", help='Camera path instead of the configured ones, for example "arc cam01 cam02" (may be repeated).'
    ),
]
ReplaceOption = Annotated[
    bool,
    typer.Option(
        "--replace",
        help="Put this capture in the place of another one of that name, and delete what was computed from that.",
    ),
]
JsonOption = Annotated[
    bool,
    typer.Option(
        "--json", help="Write one JSON object a line to standard output, for machines; sentences go to standard error."
    ),
]
VerboseOption = Annotated[
    bool,
    typer.Option(
        "--verbose",
        "-v",
        help="Say every reason, too: of effects that are off, of stages that are not needed, where the seconds went.",
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Say warnings, failures and the result alone.")]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", help="serial, local, or tcp://HOST:PORT or tls://HOST:PORT of a running scheduler."),
]


def open_session(
    config: Path | None,
    assignments: list[str] | None,
    archive: str | None,
    scheduler: str | None = None,
    machine: bool = False,
    voice: Voice = Voice.NORMAL,
) -> Session:
    """The session of a command's options. Raises ConfigError listing every fault of the configuration."""
    session = Session.open(
        config,
        [*(assignments or []), *([f"run.scheduler={scheduler}"] if scheduler else [])],
        archive,
        errors if machine else console,
    )
    return replace(session, machine=machine, voice=voice)


def voice(verbose: bool, quiet: bool) -> Voice:
    """How much a command says. Raises ConfigError where both options are given."""
    if verbose and quiet:
        raise ConfigError("--verbose and --quiet exclude each other; leave one of them out")
    return Voice.VERBOSE if verbose else Voice.QUIET if quiet else Voice.NORMAL


def selected(only: list[str] | None, start: str | None, force: list[str] | None) -> Selection:
    """Which stages a command may touch. Raises ConfigError for a name that is no stage."""
    return Selection(frozenset(only or ()), start, frozenset(force or ()))


def say(lines: list[str], style: str | None = None) -> None:
    """Print sentences as they are, unwrapped."""
    for line in lines:
        console.print(line, markup=False, style=style, soft_wrap=True)
