"""The commands that bring a sequence in: import, simulate, scans, demo."""

from __future__ import annotations

import inspect
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperArgument, TyperCommand

from posegaussian.dags.cli.options import (
    ArchiveOption,
    ConfigOption,
    ReplaceOption,
    SchedulerOption,
    SetOption,
    console,
    open_session,
    say,
)
from posegaussian.dags.export.output_paths import output_folder
from posegaussian.dags.humanize.text import next_command, number
from posegaussian.dags.session.next_steps import first_look_command
from posegaussian.dags.simulation.shipped import shipped_scenes
from posegaussian.storage.model.errors import UserError


class ImportCommand(TyperCommand):
    """`import`, whose help names the layouts; the importers are loaded only to show it, as that takes a while."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """The help with one line a layout."""
        from posegaussian.storage.importers.find import AUTO
        from posegaussian.storage.importers.registry import IMPORTERS

        (layout,) = (p for p in self.params if isinstance(p, TyperArgument) and p.name == "layout")
        layout.help = f"{', '.join(IMPORTERS)}, or {AUTO} for the one that fits."
        known = "\n\n".join(f"{i.name}: {i.summary}" for i in IMPORTERS.values())
        self.help = f"{inspect.getdoc(import_capture)}\n\n{known}"
        super().format_help(ctx, formatter)


def import_capture(
    layout: Annotated[str, typer.Argument(help="Layout of the capture.")],
    source: Annotated[Path | None, typer.Argument(help="Folder of the capture.", show_default=False)] = None,
    sequence: Annotated[
        str | None, typer.Option("--sequence", help="Name of the sequence; default: the folder's name.")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            help=(
                "A choice where several files fit, as key=value, for example calibration=calib.toml (may be repeated)."
            ),
        ),
    ] = None,
    copy: Annotated[
        bool, typer.Option("--copy", help="Copy the source files into the archive instead of referring to them.")
    ] = False,
    replace: ReplaceOption = False,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Register a capture: cameras, times and sources, by their sha256.

    Example: posegaussian import pose2sim captures/balance --sequence balance
    """
    from posegaussian.dags.importing.register import find_capture, register
    from posegaussian.storage.archive.store import Archive, local_path
    from posegaussian.storage.files.write import require_writable

    if source is None:
        raise UserError(_half_said(layout))
    session = open_session(config, assignments, archive)
    require_writable(local_path(session.archive_url))  # before the capture is looked through, which may take minutes
    name = sequence or source.resolve().name
    settings = session.configuration.for_sequence(name)
    capture = find_capture(layout, source, option or [], settings)
    made, said = register(Archive.open(session.archive_url, create=True), name, capture, settings, copy, replace)
    say([*capture.notes, *said])
    numbers = capture.numbers
    console.print(
        f"sequence {made.name}: {number(len(capture.rig), 'camera')}, {number(len(numbers), 'frame')}"
        f" ({numbers[0]}..{numbers[-1]}), partitions of {number(made.partition_frames, 'frame')}, in"
        f" {session.archive_url}",
        markup=False,
        soft_wrap=True,
    )
    say([next_command("inspect", made.name, *session.options)])
    say(first_look_command(session, made.name, capture, "then, a first look in minutes"))
    say([next_command("run", "--sequence", made.name, *session.options, lead="then")])


def _half_said(word: str) -> str:
    """What `import` with a single word lacks, and the whole command."""
    from posegaussian.storage.importers.find import AUTO
    from posegaussian.storage.importers.registry import IMPORTERS

    if word in (AUTO, *IMPORTERS):
        return f"import {word}: which capture? Name its folder, too: posegaussian import {word} FOLDER"
    return (
        f"import {word}: in which layout? `posegaussian import {AUTO} {shlex.quote(word)}` finds it; `posegaussian"
        " import --help` lists all"
    )


def simulate(
    scene: Annotated[
        str,
        typer.Argument(help=f"Scene file, or the name of one that ships: {', '.join(shipped_scenes())}."),
    ],
    sequence: Annotated[
        str | None, typer.Option("--sequence", help="Name of the sequence; default: the scene's.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", help="Folder for pictures, masks, joints and depth; default: _captures/NAME in the archive."
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            "--threads", help="Pictures at a time; default: one a core. Cannot change a byte.", min=1, max=256
        ),
    ] = None,
    replace: ReplaceOption = False,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Film a simulated scene with ground truth and register it; prints which effects are simulated, and why.

    Example: posegaussian simulate messy --archive ./archive --sequence messy
    """
    from posegaussian.dags.simulation.shipped import scene_file
    from posegaussian.dags.simulation.simulate import simulate as film_scene

    if output is not None:
        output_folder("simulate --output", output)
    path = scene_file(scene)
    film_scene(
        open_session(config, assignments, archive), path, sequence or path.stem, console, output, threads, replace
    )


def scans(
    folder: Annotated[Path, typer.Argument(help="Folder of scans: a folder a scan with one OBJ file and its texture.")],
    cameras: Annotated[int, typer.Option("--cameras", help="Source cameras around each scan.", min=2, max=64)] = 8,
    held_out: Annotated[
        int, typer.Option("--held-out", help="Cameras to compare with, midway between source cameras.", min=0, max=64)
    ] = 2,
    size: Annotated[int, typer.Option("--size", help="Side of the pictures in px.", min=64, max=4096)] = 1024,
    height: Annotated[
        float, typer.Option("--height", help="Metres that every scan is brought to; scans have no common scale.")
    ] = 1.8,
    up: Annotated[str, typer.Option("--up", help="Axis of the files that points up: x, y or z.")] = "y",
    part: Annotated[
        str | None,
        typer.Option("--part", help="Some of the scans, by name in order: first:end, gps_train or gps_val."),
    ] = None,
    data_set: Annotated[
        str,
        typer.Option(
            "--data-set",
            help="What they are published as, for example THuman2.0 or Twindom: `evaluate` groups by it, and puts"
            " those of the paper's data sets beside its numbers.",
        ),
    ] = "scans",
    threads: Annotated[
        int | None, typer.Option("--threads", help="Pictures at a time; default: one a core.", min=1, max=256)
    ] = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Film a folder of textured scans (THuman2.0, Twindom, RenderPeople), one sequence a scan; what is there is kept.

    Example: posegaussian scans THuman2.0_Release --cameras 8 --part gps_val --data-set THuman2.0 --archive ./archive
    """
    from posegaussian.dags.simulation.scans import ScanRig, body_parameters, chosen, film_scans, find_scans

    found = find_scans(folder)
    some = {name: found[name] for name in chosen(list(found), part)}
    session = open_session(config, assignments, archive)
    failed = film_scans(session, some, ScanRig(cameras, held_out, size, height, up), data_set, console, threads)
    say([*failed, *body_parameters(folder, some)])
    console.print(
        f"{number(len(some) - len(failed), 'scan')} in {session.archive_url}"
        + (f", {number(len(failed), 'scan')} could not be filmed" if failed else ""),
        markup=False,
        soft_wrap=True,
    )
    console.print(next_command("run", "--archive", session.archive_url), markup=False, soft_wrap=True)
    if failed:
        raise typer.Exit(1)


def demo(
    output: Annotated[
        Path, typer.Option("--output", help="Folder for the capture, the archive and the results.")
    ] = Path("demo-output"),
    size: Annotated[int, typer.Option("--size", help="Side of the pictures in px.", min=48, max=1024)] = 256,
    frames: Annotated[int, typer.Option("--frames", help="Number of frames.", min=1, max=300)] = 24,
    scheduler: SchedulerOption = None,
) -> None:
    """Film a simulated person with eight cameras, reconstruct it and write novel views: the whole way in minutes.

    Example: posegaussian demo --output demo-output
    """
    from posegaussian.dags.simulation.demo import run_demo

    output_folder("demo --output", output)
    raise typer.Exit(run_demo(output, size, frames, scheduler, console))
