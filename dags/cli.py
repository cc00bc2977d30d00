"""The command `posegaussian`: import, plan, run, status, why, export, demo.

Exit status: 0 all done, 1 some partition failed, 2 usage or configuration, 130 interrupted.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from dags import tables
from dags.plan import Selection
from dags.session import Session
from dags.tasks import Task
from storage.errors import ConfigError, UserError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Turn multi-view video of people into novel views: an incremental batch pipeline over chunked archives.",
)
console = Console(highlight=False)
errors = Console(stderr=True, highlight=False)

ArchiveOption = Annotated[str | None, typer.Option("--archive", help="Folder of the archive; default: `archive` of the configuration.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="Configuration laid over the packaged default; default: ./pipeline.yaml where it exists.")]
SequenceOption = Annotated[list[str] | None, typer.Option("--sequence", help="Sequences to work on (a name or glob; may be repeated). Default: all.")]
SetOption = Annotated[list[str] | None, typer.Option("--set", help="Override one setting, for example --set depth.method=hull (may be repeated).")]
OnlyOption = Annotated[list[str] | None, typer.Option("--only", help="Touch these stages alone.")]
FromOption = Annotated[str | None, typer.Option("--from", help="Rerun this stage and every later one, fresh or not.")]
ForceOption = Annotated[list[str] | None, typer.Option("--force", help="Rerun these stages even where they are fresh.")]
SchedulerOption = Annotated[str | None, typer.Option("--scheduler", help="serial, local, or tcp://HOST:PORT of a running scheduler.")]


def _session(config: Path | None, assignments: list[str] | None, archive: str | None, scheduler: str | None = None) -> Session:
    return Session.open(config, [*(assignments or []), *([f"run.scheduler={scheduler}"] if scheduler else [])], archive, console)


def _selection(only: list[str] | None, start: str | None, force: list[str] | None) -> Selection:
    return Selection(frozenset(only or ()), start, frozenset(force or ()))


def _say(lines: list[str], style: str | None = None) -> None:
    for line in lines:
        console.print(line, markup=False, style=style, soft_wrap=True)


@app.command("import")
def import_capture(
    layout: Annotated[str, typer.Argument(help="pose2sim, easymocap or images.")],
    source: Annotated[Path, typer.Argument(help="Folder of the capture.")],
    sequence: Annotated[str | None, typer.Option("--sequence", help="Name of the sequence; default: the folder's name.")] = None,
    option: Annotated[list[str] | None, typer.Option("--option", help="A choice where several files fit, as key=value, for example calibration=calib.toml (may be repeated).")] = None,
    copy: Annotated[bool, typer.Option("--copy", help="Copy the source files into the archive instead of referring to them.")] = False,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Register a capture: cameras, times and sources, by their sha256.

    Example: posegaussian import pose2sim captures/balance --sequence balance --config balance.yaml
    """
    from dags.importing import find_capture, register
    from storage.archive import Archive

    session = _session(config, assignments, archive)
    name = sequence or source.resolve().name
    settings = session.configuration.for_sequence(name)
    capture = find_capture(layout, source, option or [], settings)
    made, said = register(Archive.open(session.archive_url, create=True), name, capture, settings, copy)
    _say([*capture.notes, *said])
    numbers = capture.numbers
    console.print(f"sequence {made.name}: {len(capture.rig)} cameras, {len(numbers)} frames ({numbers[0]}..{numbers[-1]}), partitions of {made.partition_frames} frames, in {session.archive_url}", markup=False, soft_wrap=True)


@app.command()
def plan(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    only: OnlyOption = None,
    start: FromOption = None,
    force: ForceOption = None,
    path: Annotated[list[str] | None, typer.Option("--path", help='Camera path to plan for instead of the configured ones, for example "arc cam01 cam02".')] = None,
) -> None:
    """Say what a run would do, and why, without doing it.

    Example: posegaussian plan --sequence 'walk*' --set smoothing.omega=0.7
    """
    session = _session(config, assignments, archive)
    plans, failed = session.usable(session.names(sequence or ()), tuple(path or ()), _selection(only, start, force))
    for p in plans:
        console.print(tables.plan_table(p))
        _say(list(p.notes), "yellow")
        if p.all_fresh:
            console.print(f"{p.context.sequence.name}: all fresh, nothing to do", markup=False)
    _say(failed, "red")
    raise typer.Exit(2 if failed else 0)


@app.command()
def run(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    only: OnlyOption = None,
    start: FromOption = None,
    force: ForceOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Do what the plan says; what is fresh is left alone, a failed partition fails alone.

    Example: posegaussian run --sequence balance --config balance.yaml
    """
    session = _session(config, assignments, archive, scheduler)
    selection = _selection(only, start, force)
    plans, failed = session.usable(session.names(sequence or ()), (), selection)
    _say(failed, "red")
    status = session.run_and_report(plans, selection)
    raise typer.Exit(max(status, 1 if failed else 0))


@app.command()
def status(sequence: SequenceOption = None, archive: ArchiveOption = None, config: ConfigOption = None, assignments: SetOption = None) -> None:
    """Show sequence by stage: how many partitions are done, stale or have warnings.

    Example: posegaussian status
    """
    session = _session(config, assignments, archive)
    plans, failed = session.usable(session.names(sequence or ()), (), Selection())
    console.print(tables.status_table(plans))
    _say(failed, "red")
    raise typer.Exit(2 if failed else 0)


@app.command()
def why(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence.")],
    stage: Annotated[str, typer.Argument(help="Name of the stage.")],
    partition: Annotated[int | None, typer.Argument(help="Number of a partition; default: all that are not fresh.")] = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Show the chain of reasons why a stage would run.

    Example: posegaussian why balance depth 3
    """
    from dags.plan import State
    from dags.plan import why as chain

    session = _session(config, assignments, archive)
    _selection([stage], None, None)
    p = session.plan(session.one_name(sequence), Selection())
    if stage in p.unneeded:
        console.print(f"{stage} is not needed: {p.unneeded[stage]}", markup=False)
        return
    chosen: list[Task] = [t for t in p.verdicts if t.stage == stage and partition in (None, t.partition)]
    if not chosen:
        raise ConfigError(f"{stage} of {sequence} has no partition {partition}; it has {len(p.context.grid.partitions)}, counted from 0")
    stale = [t for t in chosen if p.verdicts[t].state is not State.FRESH]
    for t in stale or chosen[:1]:
        _say(chain(p, t))
    if not stale:
        console.print(f"{stage}: all {len(chosen)} fresh", markup=False)


@app.command()
def export(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence.")],
    path: Annotated[str | None, typer.Option("--path", help='Camera path: orbit, held_out, "arc CAM_A CAM_B", "still CAM", or a .json file of cameras. Default: the configured one.')] = None,
    video: Annotated[Path | None, typer.Option("--video", help="Write H.264 video to this file.")] = None,
    frames: Annotated[Path | None, typer.Option("--frames", help="Write PNG pictures and frames.csv to this folder.")] = None,
    sheet: Annotated[Path | None, typer.Option("--sheet", help="Write a contact sheet (PNG) to this file.")] = None,
    alpha: Annotated[bool, typer.Option("--alpha", help="Keep the coverage as an alpha channel of the PNG pictures.")] = False,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Run what is missing for a camera path, then write video, pictures or a contact sheet.

    Example: posegaussian export balance --path "arc cam01 cam02" --video out.mp4
    """
    if not (video or frames or sheet):
        raise ConfigError("export: say what to write with --video FILE, --frames FOLDER or --sheet FILE")
    session = _session(config, assignments, archive, scheduler)
    p = session.plan(session.one_name(sequence), Selection(), (path,) if path is not None else ())
    outcome = session.run_and_report([p], Selection())
    if outcome:
        raise typer.Exit(outcome)
    from dags.exporting import write_exports

    _say(write_exports(p, video, frames, sheet, alpha))


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", help="Folder for the capture, the archive and the results.")] = Path("demo-output"),
    size: Annotated[int, typer.Option("--size", help="Side of the pictures in px.", min=48, max=1024)] = 256,
    frames: Annotated[int, typer.Option("--frames", help="Number of frames.", min=1, max=300)] = 24,
    scheduler: SchedulerOption = None,
) -> None:
    """Film an analytic person with eight cameras, reconstruct her, and write novel views: the whole way in minutes.

    Example: posegaussian demo --output demo-output
    """
    from dags.demo import run_demo

    raise typer.Exit(run_demo(output, size, frames, scheduler, console))


def main() -> None:
    """Entry point: errors the user can mend are printed as sentences, without a traceback."""
    try:
        app()
    except UserError as e:
        for line in str(e).splitlines():
            errors.print(f"[red]error:[/red] {escape(line)}", soft_wrap=True)
        sys.exit(2)
    except OSError as e:
        if e.filename is None:
            raise
        errors.print(f"error: {e.filename}: {e.strerror}; choose another place, or free this one", style="red", markup=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        errors.print("interrupted; what is done is kept, the next run goes on from here")
        sys.exit(130)



if __name__ == "__main__":
    main()
