"""The commands that plan, run and say how it stands: plan, run, status, why."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer

from posegaussian.dags.budget.points import PRESETS
from posegaussian.dags.cli.options import (
    ArchiveOption,
    ConfigOption,
    ForceOption,
    FromOption,
    JsonOption,
    OnlyOption,
    PathOption,
    QuietOption,
    SchedulerOption,
    SequenceOption,
    SetOption,
    VerboseOption,
    console,
    open_session,
    say,
    selected,
    voice,
)
from posegaussian.dags.diagnostics import held_out, tables
from posegaussian.dags.diagnostics.other_settings import made_otherwise
from posegaussian.dags.diagnostics.run_summary import MOST, results_and_next
from posegaussian.dags.export.output_paths import output_file
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.report import after_run
from posegaussian.dags.runtime.signals import STATUS as INTERRUPTED
from posegaussian.dags.session.next_steps import after_status
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.errors import ConfigError

IN_FULL = 10
"""Sequences up to which `plan` tells each in full."""


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
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Draw stages and arrays with their states: .svg, or .md for Mermaid text."),
    ] = None,
    json: JsonOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Say what a run would do, and why, without doing it; of more than ten sequences in a line each, or with -v in
    full.

    Example: posegaussian plan --sequence 'walk*' --set smoothing.omega=0.7
    """
    from posegaussian.dags.diagnostics.effects_table import effects_reasons, effects_table
    from posegaussian.dags.planning.forecast import project

    session = open_session(config, assignments, archive, scheduler, json)
    if picture:
        from posegaussian.dags.diagnostics.plan_graph import ENDINGS

        output_file("plan --picture", picture, ENDINGS)
    selection = selected(only, start, force)
    plans, failed = session.usable(session.names(sequence or ()), tuple(path or ()), selection)
    if picture:
        from posegaussian.dags.diagnostics.plan_graph import write_picture

        session.say([f"picture: {write_picture(plans, picture)}"])
    if json:
        from posegaussian.dags.diagnostics.run_log import tell_plans

        tell_plans(plans, failed)
        raise typer.Exit(2 if failed or session.refusals(plans) else 0)
    say(held_out.told(p.context for p in plans))
    if len(plans) > IN_FULL and not verbose:
        _in_short(session, plans)
    for p in plans if len(plans) <= IN_FULL or verbose else ():
        say(made_otherwise(session.archive, p))
        console.print(tables.plan_table(p))
        console.print(effects_table(p, session.history.timed))
        say(effects_reasons(p, every=verbose))
        say(list(p.notes), "yellow")
        if p.to_make:
            console.print(tables.projection_table(project(p, session.history)))
        else:
            told = "all fresh, nothing to do" if p.all_fresh else "nothing to compute"
            console.print(f"{p.context.sequence.name}: {told}", markup=False)
    say(list(session.fitted(plans)[1]))
    say(session.disk_warnings(plans), "yellow")
    failed += session.refusals(plans)
    say(failed, "red")
    if failed:
        raise typer.Exit(2)
    if all(p.all_fresh for p in plans):
        say(results_and_next(plans, session.options, selection))
    else:
        say([_run_command(session, sequence, only, start, force, path)])


def _in_short(session: Session, plans: Sequence[Plan]) -> None:
    """A line a sequence, what they are projected to take together, and the command that tells one in full."""
    from posegaussian.dags.planning.forecast import project, together

    for p in islice((p for p in plans if p.book.receipts and not p.all_fresh), MOST):
        say(made_otherwise(session.archive, p))
    found = [project(p, session.history) for p in plans]
    console.print(tables.plans_table(plans, found))
    if total := together(found):
        console.print(tables.projection_table(total))
    first = next((p for p in plans if p.to_make), plans[0]).context.sequence.name
    say([next_command("plan", "--sequence", first, *session.options, lead="one in full, or all with -v")])


def run(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    only: OnlyOption = None,
    start: FromOption = None,
    force: ForceOption = None,
    path: PathOption = None,
    budget: Annotated[
        str | None,
        typer.Option(
            "--budget",
            help="Choose settings by the time there is: seconds a frame (2s/frame) or for the whole run (3h), measured"
            f" on a few frames first; or by name, unmeasured: {', '.join(PRESETS)}. What you set yourself stays.",
        ),
    ] = None,
    quality: Annotated[
        str | None,
        typer.Option(
            "--quality",
            help="Choose the cheapest settings that draw held-out cameras so well: their box PSNR (28dB), measured on a"
            " few frames first. What you set yourself stays.",
        ),
    ] = None,
    front: Annotated[
        Path | None,
        typer.Option(
            "--front",
            help="A tradeoff.parquet: the settings that --budget or --quality chooses from, as measured on a sequence"
            " of yours, instead of those that come with the program.",
        ),
    ] = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = False,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Do what the plan says; what is fresh is left alone, a failed partition fails alone.

    Example: posegaussian run --sequence balance --budget 5s/frame
    """
    session = open_session(config, assignments, archive, scheduler, json, voice(verbose, quiet))
    after_run.check(session)
    selection, paths = selected(only, start, force), tuple(path or ())
    names = session.names(sequence or ())
    settled = None
    if not (budget is quality is front is None):
        from posegaussian.dags.budget.bought import bought

        settled = bought(session, names, paths, selection, budget, quality, front)
        session = open_session(
            config, [*(assignments or []), *settled.words], archive, scheduler, json, voice(verbose, quiet)
        )
    plans, failed = session.usable(names, paths, selection)
    session.say(failed, "red")

    def closing(seconds: float) -> None:
        session.say(settled.against(seconds, plans) if settled is not None else ())
        after_run.tell(session, seconds)

    ended = session.run_and_report(plans, selection, failed, say_next=True, closing=closing)
    session.hint([_run_command(session, sequence, only, start, force, path)] if ended == INTERRUPTED else ())
    raise typer.Exit(ended)


def _run_command(
    session: Session,
    sequence: list[str] | None,
    only: list[str] | None,
    start: str | None,
    force: list[str] | None,
    path: list[str] | None,
) -> str:
    """The line with the command that runs what these options chose."""
    chosen = {"--sequence": sequence, "--only": only, "--from": [start] if start else None, "--force": force}
    words = [w for option, given in {**chosen, "--path": path}.items() for v in given or () for w in (option, v)]
    return next_command("run", *words, *session.options)


def status(
    sequence: SequenceOption = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
    failed_only: Annotated[
        bool,
        typer.Option(
            "--failed", help="Show what failed in the last runs instead, why, and the command that retries it."
        ),
    ] = False,
) -> None:
    """Show sequence by stage: how many partitions are done, stale or have warnings, and what the modules of a stage
    took.

    Example: posegaussian status --failed
    """
    session = open_session(config, assignments, archive)
    if failed_only:
        from posegaussian.dags.diagnostics.run_log import report_failed

        there_are_some = report_failed(session, session.names(sequence or ()), console)
        say([] if there_are_some else [next_command("status", *session.options)])
        raise typer.Exit(there_are_some)
    from posegaussian.dags.diagnostics.profile import Spending
    from posegaussian.dags.diagnostics.status import every_standing
    from posegaussian.dags.planning.context import Context
    from posegaussian.storage.archive import ledger
    from posegaussian.storage.archive.receipts import has_receipts

    names = session.names(sequence or ())
    standings, failed = every_standing(session, names)
    for table in tables.status_tables(standings, console.width):
        console.print(table)
    say(
        held_out.told(
            Context(session.archive.sequence(n), session.configuration.for_sequence(n), ()) for n in standings
        )
    )
    say(Spending.of(session.archive, names).sentences())
    say([*failed, *ledger.faults(session.archive)], "red")
    undone = [name for name, row in standings.items() if not any(stage.get("done") for stage in row.values())]
    made = [name for name in undone if has_receipts(session.archive.sequence(name))]
    for name in made[:MOST]:  # each takes a plan, which a status does without
        say(made_otherwise(session.archive, session.plan(name, Selection())))
    say([after_status(session, standings.values())])
    raise typer.Exit(2 if failed else 0)


def why(
    sequence: Annotated[str, typer.Argument(help="Name of the sequence.")],
    stage: Annotated[str, typer.Argument(help="Name of the stage.")],
    partition: Annotated[
        int | None,
        typer.Argument(help="Number of a partition to tell task by task; default: all that are not fresh, in short."),
    ] = None,
    archive: ArchiveOption = None,
    config: ConfigOption = None,
    assignments: SetOption = None,
) -> None:
    """Show why a stage would run: the first cause, and what each stage on the way says; for one partition the chain of
    reasons, task by task.

    Example: posegaussian why balance depth 3
    """
    from posegaussian.dags.diagnostics.run_log import still_failed
    from posegaussian.dags.planning.explain import by_stage, first_cause, not_fresh
    from posegaussian.dags.planning.explain import why as chain
    from posegaussian.dags.planning.plan import State

    session = open_session(config, assignments, archive)
    selected([stage], None, None)
    p = session.plan(session.one_name(sequence), Selection())
    if stage in p.unneeded:
        console.print(f"{stage} is not needed: {p.unneeded[stage]}", markup=False)
        return
    chosen: list[Task] = [t for t in p.verdicts if t.stage == stage and partition in (None, t.partition)]
    if not chosen:
        raise ConfigError(
            f"{stage} of {sequence} has no partition {partition};"
            f" it has {len(p.context.grid.partitions)}, counted from 0"
        )
    stale = [t for t in chosen if p.verdicts[t].state is not State.FRESH]
    short = partition is None and bool(stale) and stale[0].partition is not None
    place = {t: n for n, t in enumerate(dict.fromkeys([*not_fresh(p, stale), *chosen]))}  # what others wait for leads
    found = [f for f in still_failed(session, [p.context.sequence.name]) if f.task in place]
    failures = sorted(found, key=lambda f: place[f.task])
    for failure in failures[:1] if short else failures:
        label, when = failure.task.label(p.context.views.names), failure.when[:19].replace("T", " ")
        say([f"{label} failed {when} UTC: {failure.error}"], "red")
    if short and len(failures) > 1:
        say([next_command("status", "--failed", *session.options, lead=f"and {len(failures) - 1} more")], "red")
    if stale:
        say([first_cause(p, stale)])
    if short:
        say(by_stage(p, stale))
        say([next_command("why", sequence, stage, str(stale[0].partition), *session.options, lead="task by task")])
    else:
        for t in stale or chosen[:1]:
            say(chain(p, t))
    if not stale:
        console.print(f"{stage}: all {len(chosen)} fresh", markup=False)
    following = ["run", "--sequence", p.context.sequence.name] if stale else ["status"]
    say([next_command(*following, *session.options)])
