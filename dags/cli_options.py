"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ArchiveOption = Annotated[str | None, typer.Option("--archive", help="Folder of the archive; default: `archive` of the configuration.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="Configuration laid over the packaged default; default: ./pipeline.yaml where it exists.")]
SequenceOption = Annotated[list[str] | None, typer.Option("--sequence", help="Sequences to work on (a name or glob; may be repeated). Default: all.")]
SetOption = Annotated[list[str] | None, typer.Option("--set", help="Override one setting, for example --set depth.method=hull (may be repeated).")]
OnlyOption = Annotated[list[str] | None, typer.Option("--only", help="Touch these stages alone.")]
FromOption = Annotated[str | None, typer.Option("--from", help="Rerun this stage and every later one, fresh or not.")]
ForceOption = Annotated[list[str] | None, typer.Option("--force", help="Rerun these stages even where they are fresh.")]
PathOption = Annotated[list[str] | None, typer.Option("--path", help='Camera path instead of the configured ones, for example "arc cam01 cam02" (may be repeated).')]
JsonOption = Annotated[bool, typer.Option("--json", help="Write one JSON object a line to standard output, for machines; sentences go to standard error.")]
SchedulerOption = Annotated[str | None, typer.Option("--scheduler", help="serial, local, or tcp://HOST:PORT of a running scheduler.")]
