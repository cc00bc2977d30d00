"""What the commands of `posegaussian` share: their options, the session these lead to, and how sentences are printed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from dags.plan import Selection
from dags.session import Session

console = Console(highlight=False)
errors = Console(stderr=True, highlight=False)

ArchiveOption = Annotated[str | None, typer.Option("--archive", help="Folder of the archive; default: `archive` of the configuration.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="Configuration laid over the packaged default; default: ./pipeline.yaml where it exists.")]
SequenceOption = Annotated[list[str] | None, typer.Option("--sequence", help="Sequences to work on (a name or glob; may be repeated). Default: all.")]
SetOption = Annotated[list[str] | None, typer.Option("--set", help="Override one setting, for example --set depth.method=hull (may be repeated).")]
OnlyOption = Annotated[list[str] | None, typer.Option("--only", help="Touch these stages alone.")]
FromOption = Annotated[str | None, typer.Option("--from", help="Rerun this stage and every later one, fresh or not.")]
ForceOption = Annotated[list[str] | None, typer.Option("--force", help="Rerun these stages even where they are fresh.")]
PathOption = Annotated[list[str] | None, typer.Option("--path", help='Camera path instead of the configured ones, for example "arc cam01 cam02" (may be repeated).')]
JsonOption = Annotated[bool, typer.Option("--json", help="Write one JSON object a line to standard output, for machines; sentences go to standard error.")]
SchedulerOption = Annotated[str | None, typer.Option("--scheduler", help="serial, local, or tcp://HOST:PORT or tls://HOST:PORT of a running scheduler.")]


def open_session(config: Path | None, assignments: list[str] | None, archive: str | None, scheduler: str | None = None, machine: bool = False) -> Session:
    """The session of a command's options. Raises ConfigError listing every fault of the configuration."""
    session = Session.open(config, [*(assignments or []), *([f"run.scheduler={scheduler}"] if scheduler else [])], archive, errors if machine else console)
    return replace(session, machine=machine)


def selected(only: list[str] | None, start: str | None, force: list[str] | None) -> Selection:
    """Which stages a command may touch. Raises ConfigError for a name that is no stage."""
    return Selection(frozenset(only or ()), start, frozenset(force or ()))


def say(lines: list[str], style: str | None = None) -> None:
    """Print sentences as they are, unwrapped."""
    for line in lines:
        console.print(line, markup=False, style=style, soft_wrap=True)
