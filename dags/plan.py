"""What a run would do and why: every task fresh, stale with reasons, or undecided because something before it is stale.

A plan reads receipts and file sizes, never data, and imports no numerical library.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from dags.context import Context
from dags.fingerprint import all_parts, own_parts, reasons
from dags.tasks import Product, Task, dependencies, inputs, producer, tasks
from stages.contract import Stage
from stages.geometry.pairs import pair_notes
from stages.registry import STAGES
from storage.errors import ConfigError
from storage.receipts import Output, Receipt, missing_files, scan_receipts
from storage.spec import digest


class State(Enum):
    """What is known of a task before a run."""

    FRESH = "fresh"
    """Its output exists and is what a run would make."""
    STALE = "stale"
    """It must run."""
    UNDECIDED = "undecided"
    """Something it reads is stale; if that turns out equal, it need not run."""


@dataclass(frozen=True)
class Selection:
    """Which stages a run may touch."""

    only: frozenset[str] = frozenset()
    """Run these stages alone; everything they read must be fresh. Empty: all."""
    start: str | None = None
    """Rerun this stage and every later one, fresh or not."""
    force: frozenset[str] = frozenset()
    """Rerun these stages even where they are fresh."""

    def __post_init__(self) -> None:
        known = [s.name for s in STAGES]
        for name in sorted({*self.only, *self.force, *([self.start] if self.start else [])}):
            if name not in known:
                raise ConfigError(f"no stage {name!r}; the stages are {', '.join(known)}")

    def forced(self, stage: str) -> str | None:
        """The option that reruns a stage though it is fresh, or None."""
        names = [s.name for s in STAGES]
        if stage in self.force:
            return f"forced by --force {stage}"
        if self.start is not None and names.index(stage) >= names.index(self.start):
            return f"forced by --from {self.start}"
        return None

    def allows(self, stage: str) -> bool:
        """Whether a stage may run at all."""
        return not self.only or stage in self.only


@dataclass
class Book:
    """The receipts of one sequence, and what they prove: outputs that are whole."""

    context: Context
    """The sequence."""
    receipts: dict[Task, Receipt] = field(default_factory=dict)
    """By task."""
    problems: dict[Task, str] = field(default_factory=dict)
    """Receipts whose files are gone or of another size."""

    @classmethod
    def open(cls, context: Context) -> Book:
        """Scan the receipts of a sequence."""
        book = cls(context)
        name = context.sequence.name
        for r in scan_receipts(context.sequence):
            task = Task(name, r.stage, r.partition, r.view, r.path)
            book.receipts[task] = r
            bad = missing_files(context.sequence, r)
            if bad:
                book.problems[task] = f"shard {bad[0]} is missing or of another size" + (f", and {len(bad) - 1} more" if len(bad) > 1 else "")
        return book

    def add(self, task: Task, receipt: Receipt) -> None:
        """Note a task that just finished."""
        self.receipts[task] = receipt
        self.problems.pop(task, None)

    def output(self, product: Product, reader: Task) -> Output | None:
        """What the producer's receipt says of a product."""
        receipt = self.receipts.get(producer(product, reader))
        if receipt is None:
            return None
        return next((o for o in receipt.outputs if (o.array, o.view) == (product.array, product.view)), None)

    def digests(self, task: Task) -> dict[Product, str] | None:
        """Content digests of everything a task reads; None when something is not there."""
        found = {}
        for i in inputs(self.context, task):
            for p in i.products:
                output = self.output(p, task)
                if output is None:
                    return None
                found[p] = output.digest
        return found


@dataclass(frozen=True)
class Verdict:
    """State of one task and why."""

    task: Task
    state: State
    reasons: tuple[str, ...]
    """Sentences; for undecided tasks the stage that is waited for."""


@dataclass
class Plan:
    """The verdicts of one sequence."""

    context: Context
    book: Book
    verdicts: dict[Task, Verdict]
    """In the order of flow."""
    unneeded: dict[str, str]
    """{stage: why this capture does not need it}."""
    notes: tuple[str, ...] = ()
    """What the user should know besides."""

    def counts(self, stage: Stage | str) -> Counter[State]:
        """How many tasks of a stage are in which state."""
        name = stage if isinstance(stage, str) else stage.name
        return Counter(v.state for v in self.verdicts.values() if v.task.stage == name)

    @property
    def all_fresh(self) -> bool:
        """Whether a run would do nothing."""
        return all(v.state is State.FRESH for v in self.verdicts.values())


def judge(book: Book, task: Task, selection: Selection, digests: Mapping[Product, str]) -> tuple[State, tuple[str, ...], dict[str, Any]]:
    """State, reasons and fingerprint parts of a task whose inputs are all there."""
    parts = all_parts(book.context, task, own_parts(book.context, task), digests)
    receipt = book.receipts.get(task)
    forced = selection.forced(task.stage)
    if receipt is None:
        return State.STALE, ("never made",), parts
    why = [] if receipt.fingerprint == digest(parts) else reasons(receipt.parts, parts) or ["its fingerprint changed"]
    why += [book.problems[task]] if task in book.problems else []
    why += [forced] if forced else []
    return (State.STALE if why else State.FRESH), tuple(why), parts


def make_plan(context: Context, selection: Selection = Selection()) -> Plan:
    """Judge every task of a sequence. Reads receipts and file sizes only."""
    book = Book.open(context)
    verdicts: dict[Task, Verdict] = {}
    for task in tasks(context):
        waiting = [d for d in dependencies(context, task) if d not in verdicts or verdicts[d].state is not State.FRESH]
        if waiting:
            verdicts[task] = _before_inputs(book, task, selection, waiting)
            continue
        digests = book.digests(task)
        assert digests is not None, f"{task.label()}: all inputs are fresh, but an output is missing from a receipt"
        state, why, _ = judge(book, task, selection, digests)
        verdicts[task] = Verdict(task, state, why)
    return Plan(context, book, verdicts, context.unneeded(), _notes(context, book))


def _before_inputs(book: Book, task: Task, selection: Selection, waiting: Iterable[Task]) -> Verdict:
    """A task whose inputs are not all fresh: stale if its own parts already say so, else undecided."""
    receipt = book.receipts.get(task)
    stages = " and ".join(dict.fromkeys(d.stage for d in waiting))
    if receipt is None:
        return Verdict(task, State.STALE, ("never made",))
    why = reasons(receipt.parts, own_parts(book.context, task))
    why += [book.problems[task]] if task in book.problems else []
    forced = selection.forced(task.stage)
    why += [forced] if forced else []
    if why:
        return Verdict(task, State.STALE, tuple(why))
    return Verdict(task, State.UNDECIDED, (f"waits for {stages}; if its content comes out equal, nothing is done here",))


def _notes(context: Context, book: Book) -> tuple[str, ...]:
    """Sequence-wide constants that were taken from other files than the capture has now, and views that are not matched."""
    found = []
    for s in STAGES:
        if not s.sequence_wide:
            continue
        now = {v: context.capture.pictures[v].digest(context.capture.numbers) for v in context.active_views}
        old = {t.view: r.facts.get("sources") for t, r in book.receipts.items() if t.stage == s.name}
        changed = [context.views.names[v] for v, d in now.items() if v in old and old[v] is not None and old[v] != d]
        if changed:
            found.append(f"{s.name} was taken before the pictures of {', '.join(changed)} changed and is kept; `run --from {s.name}` takes it anew")
    if "depth" not in context.unneeded() and context.settings.depth.method == "sgbm":
        found += pair_notes(context.rig, context.views.sources, context.settings.depth.max_angle)
    return tuple(found)


def why(plan: Plan, task: Task) -> list[str]:
    """The chain of reasons of a task, from itself back to the first stale input, indented by depth."""
    lines: list[str] = []
    seen: set[Task] = set()

    def visit(t: Task, depth: int) -> None:
        verdict = plan.verdicts[t]
        seen.add(t)
        lines.append(f"{'  ' * depth}{t.label(plan.context.views.names)}: {verdict.state.value}" + (f" ({'; '.join(verdict.reasons)})" if verdict.reasons else ""))
        for d in dependencies(plan.context, t):
            if d in plan.verdicts and plan.verdicts[d].state is not State.FRESH and d not in seen:
                visit(d, depth + 1)

    visit(task, 0)
    return lines
