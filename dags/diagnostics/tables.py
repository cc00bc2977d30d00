"""Plans and states as tables for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from posegaussian.dags.diagnostics.status import Numbers
from posegaussian.dags.humanize.text import gigabytes, number, seconds_text
from posegaussian.dags.planning.forecast import Projection
from posegaussian.dags.planning.plan import Plan, State, told
from posegaussian.stages.registry import STAGES


def plan_table(plan: Plan) -> Table:
    """One row a stage: tasks by state, how many of the fresh ones have dropped outputs, and the reasons with how many
    tasks they hold for.

    States that no task has get no column.
    """
    partitions = len(plan.context.grid.partitions)
    table = Table(
        title=(
            f"{escape(plan.context.sequence.name)}: {number(plan.context.grid.frames, 'frame')} in"
            f" {number(partitions, 'partition')}"
        ),
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    states = [s for s in State if any(v.state is s for v in plan.verdicts.values())]
    dropped = any(plan.dropped(s.name) for s in STAGES)
    table.add_column("stage", no_wrap=True)
    for column in ("tasks", *(s.value for s in states), *(["dropped"] if dropped else [])):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("why", overflow="fold")
    for stage in STAGES:
        counts = plan.counts(stage)
        if stage.name in plan.unneeded or not counts:
            reason = plan.unneeded.get(stage.name, "no camera path with truth is asked for")
            table.add_row(stage.name, "-", *[""] * (len(states) + dropped), f"not needed: {escape(reason)}")
            continue
        of_dropped = [str(plan.dropped(stage.name) or "")] if dropped else []
        table.add_row(
            stage.name,
            str(counts.total()),
            *(str(counts[s] or "") for s in states),
            *of_dropped,
            escape(told(v for v in plan.verdicts.values() if v.task.stage == stage.name)),
        )
    return table


def plans_table(plans: Sequence[Plan], projections: Sequence[Sequence[Projection]]) -> Table:
    """One row a sequence: frames, tasks to do of all, what they are projected to take, and how many notes there are."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("sequence", overflow="fold", max_width=LONGEST_NAME)
    told = any(plan.notes for plan in plans)
    for column in ("frames", "to do", "disk", "time", *(["notes"] if told else [])):
        table.add_column(column, justify="right", no_wrap=True)
    for plan, found in zip(plans, projections, strict=True):
        table.add_row(
            escape(plan.context.sequence.name),
            str(plan.context.grid.frames),
            f"{len(plan.to_make)}/{len(plan.verdicts)}",
            *(_totals(found) if found else ("", "")),
            *([str(len(plan.notes) or "")] if told else []),
        )
    return table


def projection_table(projections: Sequence[Projection]) -> Table:
    """One row a stage that has something to do: what it is expected to take at most, a guess where the archive has no
    history of it."""
    table = Table(
        title="projected, at most (undecided tasks count as if they ran)",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for column, justify in (
        ("stage", "left"),
        ("tasks", "right"),
        ("disk", "right"),
        ("RAM a task", "right"),
        ("VRAM a task", "right"),
        ("time", "right"),
    ):
        table.add_column(column, justify=justify)  # type: ignore[arg-type]
    for p in projections:
        table.add_row(
            p.stage,
            str(p.tasks),
            _said(gigabytes(p.disk), "" if p.compressed else "guess") if p.disk else "",
            gigabytes(p.ram),
            gigabytes(p.vram) if p.vram else "",
            _said(seconds_text(p.seconds), "" if p.timed == "same settings" else p.timed),
        )
    disk, seconds = _totals(projections)
    table.add_row("all", str(sum(p.tasks for p in projections)), disk, "", "", seconds, end_section=True)
    return table


def _totals(projections: Sequence[Projection]) -> tuple[str, str]:
    """Disk and time of all stages together."""
    disk, seconds = sum(p.disk for p in projections), sum(p.seconds for p in projections)
    return (
        _said(gigabytes(disk), "" if all(p.compressed for p in projections if p.disk) else "guess"),
        _said(seconds_text(seconds), "guess" if any(p.timed == "guess" for p in projections) else ""),
    )


def _said(amount: str, remark: str) -> str:
    """`3 min (guess)`."""
    return f"{amount} ({remark})" if remark else amount


MARKS = {"failed": "f", "blocked": "b", "warned": "w", "stale": "n", "undecided": "u", "dropped": "d"}
"""What a cell of the status table says besides done of all, shortened so that ten stages fit a terminal."""
TOLD = {"stale": "not made or not up to date"}
"""What a mark stands for, where the word alone would say too little."""


LONGEST_NAME = 24
"""Characters of a sequence's name beyond which it is folded."""

BETWEEN = 2
"""Columns of the terminal between two columns of the status table."""


def status_tables(standings: Mapping[str, Numbers], width: int) -> list[Table]:
    """Sequence by stage: done of all, and how many failed, are blocked by these, have warnings, are stale, undecided or
    dropped.

    Stages that do not fit `width` columns beside the sequence's name follow in a table of their own: no header and no
    number is ever broken or cut.
    """
    used = [word for word in MARKS if any(cell.get(word) for row in standings.values() for cell in row.values())]
    idle = [s.name for s in STAGES if not any(row[s.name] for row in standings.values())]
    marks = ", ".join(f"{MARKS[word]} {TOLD.get(word, word)}" for word in used)
    said = [marks, f"no sequence needs {', '.join(idle)}" if idle else ""]
    cells = {s.name: [_cell(row[s.name]) for row in standings.values()] for s in STAGES if s.name not in idle}
    longest = max((len(name) for name in standings), default=0)
    bands = _bands(cells, width - min(LONGEST_NAME, max(longest, len("sequence"))) - 2 * BETWEEN)
    tables = [_status_band(list(standings), {name: cells[name] for name in band}) for band in bands]
    tables[-1].caption = "; ".join(s for s in said if s) or None
    return tables


def _bands(cells: Mapping[str, Sequence[str]], width: int) -> list[list[str]]:
    """Stages, as many a band as fit side by side; at least one."""
    bands: list[list[str]] = [[]]
    room = width
    for name, column in cells.items():
        wide = max(len(line) for text in (name, *column) for line in text.split("\n")) + BETWEEN
        if bands[-1] and wide > room:
            bands.append([])
            room = width
        bands[-1].append(name)
        room -= wide
    return bands


def _status_band(names: Sequence[str], columns: Mapping[str, Sequence[str]]) -> Table:
    """One table of some stages."""
    table = Table(caption_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("sequence", overflow="fold", max_width=LONGEST_NAME)
    for stage in columns:
        table.add_column(stage, no_wrap=True)
    for i, name in enumerate(names):
        table.add_row(escape(name), *(column[i] for column in columns.values()))
    return table


def _cell(numbers: Mapping[str, int]) -> str:
    """`12/12`, `9/12` over `1f 2b`, or `-` for what is not needed."""
    if not numbers:
        return "-"
    extras = " ".join(f"{numbers[word]}{mark}" for word, mark in MARKS.items() if numbers[word])
    return "\n".join([f"{numbers['done']}/{numbers['all']}", *([extras] if extras else [])])


def grouped(sentences: Sequence[str], most: int = 12) -> list[str]:
    """Sentences, equal ones once with their number, at most `most` of them."""
    counted = Counter(sentences)
    lines = [f"{s} ({n}x)" if n > 1 else s for s, n in list(counted.items())[:most]]
    return [*lines, f"... and {len(counted) - most} more, in the run's log"] if len(counted) > most else lines
