"""`posegaussian evaluate --paper NAME`: the paper's table by its name, with what is measured here beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from posegaussian.dags.evaluation.methods import OURS, Method
from posegaussian.dags.evaluation.results import SIMULATED
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.reproduction import ablated, comparisons
from posegaussian.dags.reproduction.page import Page, markdown, write
from posegaussian.dags.reproduction.people import Measured, Wanted, in_archive, measured, simulated
from posegaussian.dags.reproduction.runtime import WANTED, runtime
from posegaussian.dags.runtime.signals import STATUS as INTERRUPTED
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.errors import ConfigError, UserError

BESIDE = f"{OURS},hull,ibr,3dgs,pose_off"
"""Methods of a table that compares some, where none are named."""


@dataclass(frozen=True)
class Order:
    """One call."""

    name: str
    """Of the table, as `--paper` has it."""
    globs: Sequence[str]
    """Of sequences in the archive; none: all."""
    methods: Sequence[Method]
    ablation: Path | None
    """Folder of an ablation; None: where `ablate` writes by default."""
    output: Path


@dataclass(frozen=True)
class Compared:
    """A table that is measured on sequences."""

    sets: tuple[str, ...]
    """Data sets of the paper."""
    wanted: tuple[Wanted, ...]
    """Simulated people."""
    page: Callable[[Measured, Order], Page]
    frames: int = 1
    """That a sequence has at least."""
    alone: bool = False
    """Whether it is about ours and no other method."""


COMPARED = {
    "table1": Compared(comparisons.SETS["table1"], comparisons.WANTED["table1"], lambda m, _: comparisons.table1(m)),
    "table2": Compared(comparisons.SETS["table2"], comparisons.WANTED["table2"], lambda m, _: comparisons.table2(m)),
    "table3": Compared(
        comparisons.SETS["table3"],
        comparisons.WANTED["table3"],
        lambda m, order: comparisons.table3(m, ablated.stabilizer_rows(ablated.groups_of(order.ablation)[0])),
        frames=3,
    ),
    "runtime": Compared(comparisons.SETS["table3"], WANTED, lambda m, _: runtime(m), alone=True),
}
ABLATED = {"table4": ablated.table4, "fig5": ablated.fig5}
NAMES = ("table1", "table2", "table3", "table4", "fig5", "runtime")


def checked(name: str, methods: str | None) -> str | None:
    """The methods that a table takes, as `--methods` writes them. Raises ConfigError for a name that is no table, and
    methods where a table compares none."""
    if name not in NAMES:
        raise ConfigError(f"--paper {name}: no such table; these are {', '.join(NAMES)}")
    compares = name in COMPARED and not COMPARED[name].alone
    if methods is not None and not compares:
        raise ConfigError(f"--paper {name} --methods {methods}: {name} is about our own method alone; leave it out")
    return methods or BESIDE if compares else None


def reproduce(session: Session, order: Order) -> int:
    """Measure what is missing, print the table, write it; returns the exit status.

    Raises ConfigError and ArchiveError for sequences and settings that cannot be, NotWritten.
    """
    page = (
        ABLATED[order.name](*ablated.groups_of(order.ablation)) if order.name in ABLATED else _compared(session, order)
    )
    if page is None:
        return INTERRUPTED
    session.say(markdown(page))
    session.say([write(page, order.output)])
    following = NAMES[(NAMES.index(order.name) + 1) % len(NAMES)]
    session.say([next_command("evaluate", *order.globs, *session.options, "--paper", following)])
    return page.status


def _compared(session: Session, order: Order) -> Page | None:
    """None where it was interrupted."""
    table = COMPARED[order.name]
    known, refused = in_archive(session, order.globs, (*table.sets, SIMULATED), table.frames)
    session.say(refused, "red")
    people = simulated(session, known, table.wanted, order.output)
    try:
        found = measured([*(s for s in known if s.data_set != SIMULATED), *people], order.methods)
    except UserError as e:
        raise ConfigError(f"evaluate --paper {order.name}: {e}") from e
    if found.status == INTERRUPTED:
        return None
    return table.page(replace(found, status=1) if refused else found, order)
