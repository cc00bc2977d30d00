"""The command `posegaussian`: import, simulate, plan, run, status, why, verify, gc, reshard, accept, tradeoff, export, inspect, train, ablate, models, demo.

Exit status: 0 all done, 1 some partition failed, 2 usage or configuration, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from dags import roles, tables
from dags.cli_ablate import ablate
from dags.cli_inspect import inspect
from dags.cli_models import models
from dags.cli_options import (
    ArchiveOption,
    Commands,
    ConfigOption,
    ForceOption,
    FromOption,
    JsonOption,
    OnlyOption,
    PathOption,
    QuietOption,
    ReplaceOption,
    SchedulerOption,
    SequenceOption,
    SetOption,
    VerboseOption,
    console,
    errors,
    open_session,
    say,
    selected,
    voice,
)
from dags.cli_train import train
from dags.outputs import output_file, output_folder
from dags.selection import Selection
from dags.tasks import Task
from dags.wording import number
from storage.errors import ConfigError, UserError
from storage.files import FULL

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Turn multi-view video of people into novel views: an incremental batch pipeline over chunked archives.",
)
app.add_typer(models, name="models")
@app.command("import")
def import_capture(
    layout: Annotated[str, typer.Argument(help="pose2sim, caliscope, easymocap, images, or auto for the one that fits.")],
    source: Annotated[Path, typer.Argument(help="Folder of the capture.")],
    sequence: Annotated[str | None, typer.Option("--sequence", help="Name of the sequence; default: the folder's name.")] = None,
    option: Annotated[list[str] | None, typer.Option("--option", help="A choice where several files fit, as key=value, for example calibration=calib.toml (may be repeated).")] = None,
    copy: Annotated[bool, typer.Option("--copy", help="Copy the source files into the archive instead of referring to them.")] = False,
    replace: ReplaceOption = False,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Register a capture: cameras, times and sources, by their sha256.

    Example: posegaussian import pose2sim captures/balance --sequence balance
    """
    from dags.importing import find_capture, register
    from storage.archive import Archive

    session = open_session(config, assignments, archive)
    name = sequence or source.resolve().name
    settings = session.configuration.for_sequence(name)
    capture = find_capture(layout, source, option or [], settings)
    made, said = register(Archive.open(session.archive_url, create=True), name, capture, settings, copy, replace)
    say([*capture.notes, *said])
    numbers = capture.numbers
    console.print(f"sequence {made.name}: {number(len(capture.rig), 'camera')}, {number(len(numbers), 'frame')} ({numbers[0]}..{numbers[-1]}), partitions of {number(made.partition_frames, 'frame')}, in {session.archive_url}", markup=False, soft_wrap=True)


@app.command()
def simulate(
    scene: Annotated[str, typer.Argument(help="Scene file, or the name of one that ships: demo, plain, fast_motion, self_occlusion, messy, sparse_6, dense_16, single_pair, two_people.")],
    sequence: Annotated[str | None, typer.Option("--sequence", help="Name of the sequence; default: the scene's.")] = None,
    output: Annotated[Path | None, typer.Option("--output", help="Folder for pictures, masks, joints and depth; default: _captures/NAME in the archive.")] = None,
    threads: Annotated[int | None, typer.Option("--threads", help="Pictures at a time; default: one a core. Cannot change a byte.", min=1, max=256)] = None,
    replace: ReplaceOption = False,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Film a simulated scene with ground truth and register it; prints which effects are simulated, and why.

    Example: posegaussian simulate messy --archive ./archive --sequence messy
    """
    from dags.simulate import scene_file
    from dags.simulate import simulate as film_scene

    if output is not None:
        output_folder("simulate --output", output)
    path = scene_file(scene)
    film_scene(open_session(config, assignments, archive), path, sequence or path.stem, console, output, threads, replace)


@app.command()
def plan(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    only: OnlyOption = None,
    start: FromOption = None,
    force: ForceOption = None,
    path: PathOption = None,
    scheduler: SchedulerOption = None,
    picture: Annotated[Path | None, typer.Option("--picture", help="Draw stages and arrays with their states: .svg, or .md for Mermaid text.")] = None,
    json: JsonOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Say what a run would do, and why, without doing it.

    Example: posegaussian plan --sequence 'walk*' --set smoothing.omega=0.7
    """
    from dags.effects_table import effects_reasons, effects_table
    from dags.projection import project

    session = open_session(config, assignments, archive, scheduler, json)
    if picture:
        from dags.picture import WRITERS

        output_file("plan --picture", picture, WRITERS)
    plans, failed = session.usable(session.names(sequence or ()), tuple(path or ()), selected(only, start, force))
    if picture:
        from dags.picture import write_picture

        session.say([f"picture: {write_picture(plans, picture)}"])
    if json:
        from dags.history import tell_plans

        tell_plans(plans, failed)
        raise typer.Exit(2 if failed or session.refusals(plans) else 0)
    say(roles.told(p.context for p in plans))
    for p in plans:
        console.print(tables.plan_table(p))
        console.print(effects_table(p, session.history.rows))
        say(effects_reasons(p, every=verbose))
        say(list(p.notes), "yellow")
        if p.all_fresh:
            console.print(f"{p.context.sequence.name}: all fresh, nothing to do", markup=False)
        else:
            console.print(tables.projection_table(project(p, session.history)))
    say(session.thrown_away(plans), "yellow")
    failed += session.refusals(plans)
    say(failed, "red")
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
    path: PathOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = False,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Do what the plan says; what is fresh is left alone, a failed partition fails alone.

    Example: posegaussian run --sequence balance
    """
    session = open_session(config, assignments, archive, scheduler, json, voice(verbose, quiet))
    selection = selected(only, start, force)
    plans, failed = session.usable(session.names(sequence or ()), tuple(path or ()), selection)
    session.say(failed, "red")
    raise typer.Exit(session.run_and_report(plans, selection, failed, say_next=True))


@app.command()
def status(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    failed_only: Annotated[bool, typer.Option("--failed", help="Show what failed in the last runs instead, why, and the command that retries it.")] = False,
) -> None:
    """Show sequence by stage: how many partitions are done, stale or have warnings, and what the modules of a stage took.

    Example: posegaussian status --failed
    """
    session = open_session(config, assignments, archive)
    if failed_only:
        from dags.history import report_failed

        raise typer.Exit(report_failed(session.archive, session.names(sequence or ()), console))
    from dags.context import Context
    from dags.spending import Spending
    from dags.status import every_standing

    names = session.names(sequence or ())
    standings, failed = every_standing(session, names)
    for table in tables.status_tables(standings, console.width):
        console.print(table)
    say(roles.told(Context(session.archive.sequence(n), session.configuration.for_sequence(n), ()) for n in standings))
    say(Spending.of(session.archive, names).sentences())
    say(failed, "red")
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
    from dags.explain import why as chain
    from dags.history import still_failed
    from dags.plan import State

    session = open_session(config, assignments, archive)
    selected([stage], None, None)
    p = session.plan(session.one_name(sequence), Selection())
    if stage in p.unneeded:
        console.print(f"{stage} is not needed: {p.unneeded[stage]}", markup=False)
        return
    chosen: list[Task] = [t for t in p.verdicts if t.stage == stage and partition in (None, t.partition)]
    if not chosen:
        raise ConfigError(f"{stage} of {sequence} has no partition {partition}; it has {len(p.context.grid.partitions)}, counted from 0")
    for failure in still_failed(session.archive, [p.context.sequence.name]):
        if failure.task in chosen:
            say([f"{failure.task.label(p.context.views.names)} failed {failure.when[:19].replace('T', ' ')} UTC: {failure.error}"], "red")
    stale = [t for t in chosen if p.verdicts[t].state is not State.FRESH]
    for t in stale or chosen[:1]:
        say(chain(p, t))
    if not stale:
        console.print(f"{stage}: all {len(chosen)} fresh", markup=False)


@app.command()
def verify(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    repair: Annotated[bool, typer.Option("--repair", help="Remove the receipts of what is broken, so that the next run makes it anew, and delete left-overs.")] = False,
) -> None:
    """Read everything again and compare it with its receipts: sizes, checksums, decoded contents.

    Example: posegaussian verify --sequence balance --repair
    """
    from dags.verify import verify as read_again

    session = open_session(config, assignments, archive)
    raise typer.Exit(read_again(session, session.names(sequence or ()), repair))


@app.command()
def gc(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    apply: Annotated[bool, typer.Option("--apply", help="Delete; without it only say what could go.")] = False,
    kind: Annotated[list[str] | None, typer.Option("--kind", help="Only these kinds: arrays, paths, range, stages, strays, variants, runs (may be repeated).")] = None,
) -> None:
    """Say what could be deleted under these settings, how many bytes, and what would have to be computed again; delete with --apply.

    Example: posegaussian gc --kind arrays --kind strays --apply
    """
    from dags.gc import collect

    session = open_session(config, assignments, archive)
    raise typer.Exit(collect(session, session.names(sequence or ()), kind or [], apply))


@app.command()
def reshard(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence.")],
    frames: Annotated[int, typer.Option("--frames", help="Frames of a partition.", min=1, max=4096)],
    path: Annotated[list[str] | None, typer.Option("--path", help="Camera paths to carry over instead of the configured ones (may be repeated).")] = None,
    give_up: Annotated[bool, typer.Option("--give-up", help="Let go of what is not fresh or not asked for; it cannot be carried over.")] = False,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Cut a sequence into partitions of another length, without computing anything again.

    Example: posegaussian reshard balance --frames 4
    """
    from dags.reshard import reshard as cut

    session = open_session(config, assignments, archive)
    say(cut(session.plan(session.names([sequence])[0], Selection(), tuple(path or ())), frames, give_up))


@app.command()
def accept(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence.")],
    stage: Annotated[str, typer.Argument(help="Name of the stage whose outputs are kept as they are.")],
    reason: Annotated[str, typer.Option("--reason", help="Why the change cannot matter; kept in the receipts.")],
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Keep a stage's outputs after a harmless change of its code, version or settings, instead of computing them again.

    Example: posegaussian accept balance depth --reason "renamed a variable"
    """
    from dags.accept import accept as keep

    session = open_session(config, assignments, archive)
    selected([stage], None, None)
    say(keep(session.plan(session.names([sequence])[0], Selection()), stage, reason))


@app.command()
def tradeoff(
    knob: Annotated[list[str], typer.Option("--knob", help="A setting with quality levels, for example depth.method (may be repeated: the cross product is run).")],
    sequence: Annotated[str | None, typer.Option("--sequence", help="Sequence to measure on; default: the only one.")] = None,
    levels: Annotated[list[str] | None, typer.Option("--levels", help="Levels of a knob instead of the declared ones, for example frames.size=128,256 (may be repeated).")] = None,
    repeats: Annotated[int, typer.Option("--repeats", help="Times every stage that differs is measured; the median counts.", min=1, max=99)] = 3,
    output: Annotated[Path | None, typer.Option("--output", help="Folder for the table, the Parquet file and the picture; default: tradeoff-SEQUENCE.")] = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Measure what quality costs: run the levels of some settings, seconds a frame against PSNR, SSIM and EPE.

    Example: posegaussian tradeoff --knob depth.method --knob frames.size --levels frames.size=128,256
    """
    from dags.tradeoff import run_tradeoff

    if output is not None:
        output_folder("tradeoff --output", output)
    run_tradeoff(open_session(config, assignments, archive), sequence, knob, levels or [], repeats, output)


@app.command()
def export(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence.")],
    path: Annotated[str | None, typer.Option("--path", help='Camera path: between, orbit, held_out, "arc CAM_A CAM_B", "still CAM", "sway [CAM [DEGREES]]", or a .json file of cameras. Default: the configured one.')] = None,
    video: Annotated[Path | None, typer.Option("--video", help="Write H.264 video to this file.")] = None,
    frames: Annotated[Path | None, typer.Option("--frames", help="Write PNG pictures and frames.csv to this folder.")] = None,
    sheet: Annotated[Path | None, typer.Option("--sheet", help="Write a contact sheet (PNG) to this file.")] = None,
    alpha: Annotated[bool, typer.Option("--alpha", help="Keep the coverage as an alpha channel of the PNG pictures.")] = False,
    background: Annotated[str, typer.Option("--background", help="What videos and pictures stand on: none (black), plate (what the camera itself filmed behind the subject), '#RRGGBB', or a picture file.")] = "none",
    splats: Annotated[Path | None, typer.Option("--splats", help="Write the Gaussians of every frame to this folder, one 3DGS PLY each.")] = None,
    view: Annotated[list[str] | None, typer.Option("--view", help="Source view whose Gaussians --splats writes (may be repeated). Default: all.")] = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    scheduler: SchedulerOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Run what is missing for a camera path, then write video, pictures, a contact sheet, or the Gaussians themselves.

    Example: posegaussian export balance --path "arc cam01 cam02" --video out.mp4
    """
    from dags.export_order import ExportOrder

    order = ExportOrder.of(video, frames, sheet, splats, tuple(view or ()), alpha, background)
    unrendered = [] if order.renders else ["rendering.paths=[]"]
    session = open_session(config, [*(assignments or []), *unrendered], archive, scheduler, voice=voice(verbose, quiet))
    p = session.plan(session.one_name(sequence), Selection(), (path,) if path is not None and order.renders else (), order.needed)
    order.check(p.context)
    outcome = session.run_and_report([p], Selection())
    if outcome:
        raise typer.Exit(outcome)
    say(order.write(p))


app.command()(inspect)
app.command()(train)
app.command()(ablate)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", help="Folder for the capture, the archive and the results.")] = Path("demo-output"),
    size: Annotated[int, typer.Option("--size", help="Side of the pictures in px.", min=48, max=1024)] = 256,
    frames: Annotated[int, typer.Option("--frames", help="Number of frames.", min=1, max=300)] = 24,
    scheduler: SchedulerOption = None,
) -> None:
    """Film a simulated person with eight cameras, reconstruct her, and write novel views: the whole way in minutes.

    Example: posegaussian demo --output demo-output
    """
    from dags.demo import run_demo

    output_folder("demo --output", output)
    raise typer.Exit(run_demo(output, size, frames, scheduler, console))


def main() -> None:
    """Entry point: errors the user can mend are printed as sentences, without a traceback."""
    try:
        app()
    except UserError as e:
        for line in str(e).splitlines():  # indented lines are settings to copy, as they stand
            errors.print(escape(line) if line.startswith(" ") else f"[red]error:[/red] {escape(line)}", soft_wrap=True)
        sys.exit(2)
    except OSError as e:
        if e.filename is None and e.errno not in FULL:
            raise
        errors.print(f"error: {e.filename or 'standard output'}: {e.strerror}; choose another place, or free this one", style="red", markup=False, soft_wrap=True)
        if e.filename is None:  # what is left of the output would be tried once more at the end, and fail with a traceback
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(2)
    except KeyboardInterrupt:
        errors.print("interrupted; what is done is kept, the next run goes on from here")
        sys.exit(130)



if __name__ == "__main__":
    main()
