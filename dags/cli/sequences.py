"""The commands that bring a sequence in: import, simulate, demo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
from posegaussian.dags.humanize.text import number


def import_capture(
    layout: Annotated[
        str, typer.Argument(help="pose2sim, caliscope, easymocap, images, or auto for the one that fits.")
    ],
    source: Annotated[Path, typer.Argument(help="Folder of the capture.")],
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
    from posegaussian.storage.archive.store import Archive

    session = open_session(config, assignments, archive)
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


def simulate(
    scene: Annotated[
        str,
        typer.Argument(
            help=(
                "Scene file, or the name of one that ships: demo, plain, fast_motion, self_occlusion, messy, sparse_6,"
                " dense_16, single_pair, two_people."
            )
        ),
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
    from posegaussian.dags.simulation.simulate import scene_file
    from posegaussian.dags.simulation.simulate import simulate as film_scene

    if output is not None:
        output_folder("simulate --output", output)
    path = scene_file(scene)
    film_scene(
        open_session(config, assignments, archive), path, sequence or path.stem, console, output, threads, replace
    )


def demo(
    output: Annotated[
        Path, typer.Option("--output", help="Folder for the capture, the archive and the results.")
    ] = Path("demo-output"),
    size: Annotated[int, typer.Option("--size", help="Side of the pictures in px.", min=48, max=1024)] = 256,
    frames: Annotated[int, typer.Option("--frames", help="Number of frames.", min=1, max=300)] = 24,
    scheduler: SchedulerOption = None,
) -> None:
    """Film a simulated person with eight cameras, reconstruct her, and write novel views: the whole way in minutes.

    Example: posegaussian demo --output demo-output
    """
    from posegaussian.dags.simulation.demo import run_demo

    output_folder("demo --output", output)
    raise typer.Exit(run_demo(output, size, frames, scheduler, console))
