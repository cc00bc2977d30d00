"""Plans and states as tables for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from dags.plan import Plan, State
from dags.projection import Projection, gigabytes
from stages.registry import STAGES

MOST_REASONS = 4
"""Different reasons shown for one stage; the rest is counted."""


def plan_table(plan: Plan) -> Table:
    """One row a stage: tasks by state, how many of the fresh ones have dropped outputs, and the reasons with how many tasks they hold for."""
    table = Table(title=f"{plan.context.sequence.name}: {plan.context.grid.frames} frames in {len(plan.context.grid.partitions)} partitions", title_justify="left")
    for column, justify in (("stage", "left"), ("tasks", "right"), ("fresh", "right"), ("stale", "right"), ("undecided", "right"), ("dropped", "right"), ("why", "left")):
        table.add_column(column, justify=justify, overflow="fold")  # type: ignore[arg-type]
    for stage in STAGES:
        if stage.name in plan.unneeded:
            table.add_row(stage.name, "-", "", "", "", "", f"not needed: {escape(plan.unneeded[stage.name])}")
            continue
        counts = plan.counts(stage)
        if not counts:
            table.add_row(stage.name, "-", "", "", "", "", "not needed: no camera path with truth is asked for")
            continue
        reasons = Counter(r for v in plan.verdicts.values() if v.task.stage == stage.name and v.state is not State.FRESH for r in v.reasons)
        table.add_row(stage.name, str(counts.total()), *(str(counts[s]) if counts[s] else "" for s in State), str(plan.dropped(stage.name) or ""), escape("; ".join(_counted(reasons))))
    return table


def _counted(reasons: Counter[str]) -> list[str]:
    shown = [f"{r} ({n}x)" if n > 1 else r for r, n in reasons.most_common(MOST_REASONS)]
    rest = len(reasons) - len(shown)
    return [*shown, f"and {rest} more reasons"] if rest else shown


def projection_table(projections: Sequence[Projection]) -> Table:
    """One row a stage that has something to do: what it is expected to take at most."""
    table = Table(title="projected, at most (undecided tasks count as if they ran)", title_justify="left")
    for column, justify in (("stage", "left"), ("tasks", "right"), ("disk", "right"), ("RAM a task", "right"), ("VRAM a task", "right"), ("time", "right")):
        table.add_column(column, justify=justify)  # type: ignore[arg-type]
    for p in projections:
        table.add_row(p.stage, str(p.tasks), (gigabytes(p.disk) + ("" if p.compressed else " raw")) if p.disk else "", gigabytes(p.ram), gigabytes(p.vram) if p.vram else "", seconds_text(p.seconds) + ("" if p.same or p.seconds is None else " (other settings)"))
    known = [p.seconds for p in projections if p.seconds is not None]
    total = seconds_text(sum(known)) if len(known) == len(projections) else f"more than {seconds_text(sum(known))}" if known else "unknown"
    table.add_row("all", str(sum(p.tasks for p in projections)), gigabytes(sum(p.disk for p in projections)), "", "", total, end_section=True)
    return table


def seconds_text(seconds: float | None) -> str:
    """Seconds of work for people."""
    if seconds is None:
        return "unknown"
    if seconds < 90:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def status_table(plans: Sequence[Plan]) -> Table:
    """Sequence by stage: done of all; warnings, stale and undecided ones named."""
    table = Table()
    table.add_column("sequence")
    for stage in STAGES:
        table.add_column(stage.name)
    for plan in plans:
        table.add_row(plan.context.sequence.name, *(_cell(plan, s.name) for s in STAGES))
    return table


def _cell(plan: Plan, stage: str) -> str:
    if stage in plan.unneeded:
        return "not needed"
    counts = plan.counts(stage)
    if not counts:
        return "not needed"
    warned = sum(1 for t, r in plan.book.receipts.items() if t.stage == stage and t in plan.verdicts and plan.verdicts[t].state is State.FRESH and r.warnings)
    extras = [f"{n} {word}" for word, n in (("warned", warned), ("stale", counts[State.STALE]), ("undecided", counts[State.UNDECIDED]), ("dropped", plan.dropped(stage))) if n]
    return f"{counts[State.FRESH]}/{counts.total()} done" + (f" ({', '.join(extras)})" if extras else "")


def grouped(sentences: Sequence[str], most: int = 12) -> list[str]:
    """Sentences, equal ones once with their number, at most `most` of them."""
    counted = Counter(sentences)
    lines = [f"{s} ({n}x)" if n > 1 else s for s, n in list(counted.items())[:most]]
    return [*lines, f"... and {len(counted) - most} more, in the run's log"] if len(counted) > most else lines
