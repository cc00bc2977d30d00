"""The commands that make files and tables of results: export, tradeoff, effects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.cli.options import (
    ArchiveOption,
    ConfigOption,
    QuietOption,
    SchedulerOption,
    SetOption,
    VerboseOption,
    open_session,
    say,
    voice,
)
from posegaussian.dags.export.output_paths import output_folder
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.next_steps import after_export
from posegaussian.storage.exporters.layouts.registry import LAYOUTS
from posegaussian.storage.model.errors import ConfigError

ExportPathOption = Annotated[
    str | None,
    typer.Option(
        "--path",
        help=(
            'Camera path: between, orbit, held_out, "arc CAM_A CAM_B", "still CAM", "sway [CAM [DEGREES]]", or a'
            " .json file of cameras. Default: the configured one."
        ),
    ),
]
VideoOption = Annotated[
    Path | None,
    typer.Option("--video", help="Write H.264 video to this file, or of several paths and cameras beside it."),
]
FramesOption = Annotated[
    Path | None,
    typer.Option(
        "--frames", help="Write PNG pictures and frames.csv to this folder, or to a folder a path in it of several."
    ),
]
SheetOption = Annotated[
    Path | None,
    typer.Option("--sheet", help="Write a contact sheet (PNG) to this file, or one a path beside it."),
]
AlphaOption = Annotated[
    bool, typer.Option("--alpha", help="Keep the coverage as an alpha channel of the PNG pictures.")
]
BackgroundOption = Annotated[
    str,
    typer.Option(
        "--background",
        help=(
            "What videos and pictures stand on: none (black), plate (what the camera itself filmed behind the"
            " subject), '#RRGGBB', or a picture file."
        ),
    ),
]
SplatsOption = Annotated[
    Path | None,
    typer.Option("--splats", help="Write the Gaussians of every frame to this folder, one 3DGS PLY each."),
]
PageOption = Annotated[
    Path | None,
    typer.Option("--page", help="Write one HTML file that plays the Gaussians in any browser, without a server."),
]
PageGaussiansOption = Annotated[
    int | None,
    typer.Option(
        "--page-gaussians",
        help="Gaussians a frame of --page, about, at most: pixels are merged 2 x 2, 3 x 3, ... Default: all.",
        min=1000,
    ),
]
SplatsAsOption = Annotated[
    str,
    typer.Option(
        "--splats-as",
        help="How --splats names and writes files: ply (000012.ply), spz (000012.spz, a quarter to a sixth of the"
        " bytes), or sequence (frame0001.ply, which SuperSplat plays).",
    ),
]
ViewOption = Annotated[
    list[str] | None,
    typer.Option(
        "--view", help="Source view whose Gaussians --splats and --page write (may be repeated). Default: all."
    ),
]
LayoutOption = Annotated[
    str | None,
    typer.Option(
        "--to",
        help=(
            "Write undistorted pictures, masks, cameras and a cloud for other tools, in the layout"
            f" {' or '.join(LAYOUTS)}."
        ),
    ),
]
OutputOption = Annotated[Path | None, typer.Option("--output", help="Folder for --to; default: SEQUENCE-LAYOUT.")]
FrameOption = Annotated[
    int | None, typer.Option("--frame", help="Source frame number of the one instant of --to. Default: all.")
]
BudgetOption = Annotated[
    float | None,
    typer.Option(
        "--budget",
        help="Merge the Gaussians of --splats, and of the cloud of --to, to no more than this share of a frame's"
        " (up to 1) or this number. Default: all of them.",
    ),
]


def export(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence.")],
    path: ExportPathOption = None,
    video: VideoOption = None,
    frames: FramesOption = None,
    sheet: SheetOption = None,
    alpha: AlphaOption = False,
    background: BackgroundOption = "none",
    splats: SplatsOption = None,
    page: PageOption = None,
    page_gaussians: PageGaussiansOption = None,
    splats_as: SplatsAsOption = "ply",
    view: ViewOption = None,
    to: LayoutOption = None,
    output: OutputOption = None,
    frame: FrameOption = None,
    budget: BudgetOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    scheduler: SchedulerOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Run what is missing for a camera path, then write video, pictures, a contact sheet, the Gaussians themselves, a
    page that plays them, or the capture in another tool's layout.

    Example: posegaussian export balance --path "arc cam01 cam02" --video out.mp4
    """
    from posegaussian.dags.diagnostics.other_settings import made_otherwise
    from posegaussian.dags.export.background import parse
    from posegaussian.dags.export.request import ExportOrder

    order = ExportOrder(
        video=video,
        frames=frames,
        sheet=sheet,
        splats=splats,
        views=tuple(view or ()),
        alpha=alpha,
        backdrop=parse(background),
        splats_as=splats_as,
        layout=to,
        folder=output or (Path(f"{sequence}-{to}") if to else None),
        frame=frame,
        page=page,
        path=path,
        page_gaussians=page_gaussians,
        budget=budget,
    )
    asked = open_session(config, assignments, archive, scheduler)
    unrendered = [] if order.renders else ["rendering.paths=[]"]
    session = open_session(config, [*(assignments or []), *unrendered], archive, scheduler, voice=voice(verbose, quiet))
    name = session.one_name(sequence)
    if page and path is None and not order.renders:  # what is not rendered is still the way the page flies
        configured = asked.configuration.for_sequence(name).rendering.paths
        order = replace(order, path=next(iter(configured or ()), None))
    p = session.plan(name, Selection(), (path,) if path is not None and order.renders else (), order.needed)
    order.check(p.context)
    session.hint(made_otherwise(session.archive, p))
    outcome = session.run_and_report([p], Selection())
    if outcome:
        raise typer.Exit(outcome)
    say(order.write(p))
    session.hint([after_export(asked, name, path, page is not None, order.renders)])


def tradeoff(
    knob: Annotated[
        list[str] | None,
        typer.Option(
            "--knob",
            help="A setting with quality levels, for example depth.method (may be repeated: the cross product is run,"
            " or searched).",
        ),
    ] = None,
    sequence: Annotated[
        str | None, typer.Option("--sequence", help="Sequence to measure on; default: the only one.")
    ] = None,
    search: Annotated[
        bool,
        typer.Option(
            "--search",
            help="Do not run every combination: search for the front on a few frames, over the named knobs or those"
            " that matter most.",
        ),
    ] = False,
    runs: Annotated[
        int | None,
        typer.Option(
            "--runs", help="Settings that a search runs, on few frames and on more; default: 60.", min=15, max=600
        ),
    ] = None,
    levels: Annotated[
        list[str] | None,
        typer.Option(
            "--levels",
            help="Levels of a knob instead of the declared ones, for example frames.size=128,256 (may be repeated).",
        ),
    ] = None,
    repeats: Annotated[
        int | None,
        typer.Option(
            "--repeats",
            help="Times every stage that differs is measured; the median counts. Default: 3, of a search 1.",
            min=1,
            max=99,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", help="Folder for the table, the Parquet file and the picture; default: tradeoff-SEQUENCE."
        ),
    ] = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    r"""Measure what quality costs: run the levels of some settings, seconds a frame against PSNR, SSIM and EPE.

    Example: posegaussian tradeoff --search --sequence balance --set 'views.held_out=\[cam02]'
    """
    from posegaussian.dags.tradeoff.searched import run_search
    from posegaussian.dags.tradeoff.tradeoff import run_tradeoff, table_file

    if output is not None:
        output_folder("tradeoff --output", output)
    if not knob and not search:
        raise ConfigError(
            "tradeoff: name a setting, for example --knob depth.method, or let --search find which settings matter"
        )
    if runs is not None and not search:
        raise ConfigError(f"tradeoff: --runs {runs} is for --search; without it every combination of levels is run")
    session = open_session(config, assignments, archive)
    better: tuple[str, ...] = ()
    if search:
        made, better = run_search(session, sequence, knob or [], levels or [], runs or 60, repeats or 1, output)
    else:
        made = run_tradeoff(session, sequence, knob or [], levels or [], repeats or 3, output)
    name = made[0].context.sequence.name
    further = [word for w in better for word in ("--set", w)]
    further = further or ["--budget", "3s/frame", "--front", str(table_file(name, output))]
    # what was tried at other values is not what the run is to have
    tried = tuple(f"{knob}=" for knob in made[0].values)
    pairs = zip(session.options[::2], session.options[1::2], strict=True)
    options = [word for pair in pairs if not pair[1].startswith(tried) for word in pair]
    say([next_command("run", "--sequence", name, *options, *further)])


def effects(
    regret: Annotated[
        str,
        typer.Option("--regret", help="Sequence whose effects are turned, one at a time, against their decisions."),
    ],
    pairs: Annotated[bool, typer.Option("--pairs", help="Turn every two of them together, too.")] = False,
    repeats: Annotated[
        int,
        typer.Option("--repeats", help="Times every stage that differs is measured; the median counts.", min=1, max=99),
    ] = 1,
    table: Annotated[Path | None, typer.Option("--table", help="Write the table to this Parquet file, too.")] = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    r"""Measure what the decisions about effects cost: each is turned the other way, and held-out cameras and the clock
    say what that is worth.

    Example: posegaussian effects --regret walk --set 'views.held_out=\[cam05]' --set frames.range=0:8
    """
    from posegaussian.dags.regret.regret import as_lines, measured, rows
    from posegaussian.dags.tradeoff.tradeoff import write_parquet

    session = open_session(config, assignments, archive)
    name = session.one_name(regret)
    found = measured(session, name, pairs, repeats)
    session.say(as_lines(found))
    if table is not None:
        write_parquet(table, rows(found), {"sequence": name, "repeats": str(repeats)})
        session.say([f"table: {table}"])
    session.hint([next_command("plan", "--sequence", name, "-v", *session.options)])
