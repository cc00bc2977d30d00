"""What a run would do and why: every task fresh, stale with reasons, or undecided because something before it is stale.

A plan reads receipts and file sizes, never data, and imports no numerical library.
"""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from textwrap import shorten
from typing import Any

import numpy as np

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.effects import ChoiceVerdict, EffectVerdict, noted
from posegaussian.dags.planning.fingerprint import all_parts, own_parts, reasons, still_good
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import PRODUCERS, Product, Task, dependencies, measuring, tasks, tasks_of
from posegaussian.stages.contract.declaration import Stage
from posegaussian.stages.registry import STAGES, TRUST
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive import set_aside
from posegaussian.storage.archive.receipts import Receipt, ReceiptKey
from posegaussian.storage.model.spec import digest

TAKEN_OVER = "taken over from an earlier run with these settings"
"""Why a task is not computed though its own output is other."""


class State(Enum):
    """What is known of a task before a run."""

    FRESH = "fresh"
    """Its output exists and is what a run would make."""
    STALE = "stale"
    """It must run."""
    UNDECIDED = "undecided"
    """Something it reads is stale; if that turns out equal, it need not run."""
    KEPT = "kept"
    """An earlier run made what this one would make, and it was put aside: it is taken over."""


READY = (State.FRESH, State.KEPT)
"""States of tasks that are not computed."""


@dataclass(frozen=True)
class TaskVerdict:
    """State of one task and why."""

    task: Task
    state: State
    reasons: tuple[str, ...]
    """Sentences; for undecided tasks the stage that is waited for."""


MOST_REASONS = 4
"""Different reasons shown for one stage; the rest is counted."""
LINE = 160
"""Characters of a stage's line in a plan that is printed."""


def told(verdicts: Iterable[TaskVerdict]) -> str:
    """Reasons of tasks, each with how many it holds for, the rest counted."""
    reasons = Counter(r for v in verdicts if v.state is not State.FRESH for r in v.reasons)
    shown = [f"{r} ({n}x)" if n > 1 else r for r, n in reasons.most_common(MOST_REASONS)]
    rest = len(reasons) - len(shown)
    return "; ".join([*shown, f"and {number(rest, 'more reason')}"] if rest else shown)


@dataclass(repr=False)
class Plan:
    """The verdicts of one sequence."""

    context: Context
    book: Book
    verdicts: dict[Task, TaskVerdict]
    """In the order of flow."""
    unneeded: dict[str, str]
    """{stage: why this capture does not need it}."""
    selection: Selection = Selection()
    """Which stages a run may touch."""
    wanted: Callable[[Context], frozenset[Product]] | None = None
    """What must be there afterwards, whatever `keep` says; asked again when camera paths change."""

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What the user should know besides; looked at only where somebody reads it."""
        return _notes(self.context, self.book, {t for t, v in self.verdicts.items() if v.state is State.FRESH})

    @property
    def to_make(self) -> list[Task]:
        """Tasks that a run may have to compute: neither ready nor of a stage that it may not touch."""
        return [
            t
            for t, v in self.verdicts.items()
            if v.state not in READY and t.stage not in self.unneeded and self.selection.allows(t.stage)
        ]

    def dropped(self, stage: str) -> int:
        """How many fresh tasks of a stage have outputs that were dropped."""
        return sum(
            1
            for t, v in self.verdicts.items()
            if t.stage == stage and v.state is State.FRESH and any(o.dropped for o in self.book.receipts[t].outputs)
        )

    def counts(self, stage: Stage | str) -> Counter[State]:
        """How many tasks of a stage are in which state."""
        name = stage if isinstance(stage, str) else stage.name
        return Counter(v.state for v in self.verdicts.values() if v.task.stage == name)

    @property
    def all_fresh(self) -> bool:
        """Whether a run would do nothing."""
        return all(v.state is State.FRESH for v in self.verdicts.values())

    def __repr__(self) -> str:
        """A line for the sequence, and one for every stage: how many tasks are in which state, and why."""
        stages: dict[str, list[TaskVerdict]] = {}
        for v in self.verdicts.values():
            stages.setdefault(v.task.stage, []).append(v)
        lines = [
            f"plan of {self.context.sequence.name}: {len(self.to_make)} of {number(len(self.verdicts), 'task')} to do"
        ]
        for stage, found in stages.items():
            states = ", ".join(f"{n} {state.value}" for state, n in self.counts(stage).items())
            lines.append(
                shorten("; ".join(filter(None, [f"{stage}: {states}", told(found)])), LINE, placeholder=" ...")
            )
        return "\n".join(lines)


def judge(
    book: Book, task: Task, selection: Selection, digests: Mapping[Product, str]
) -> tuple[State, tuple[str, ...], dict[str, Any]]:
    """State, reasons and fingerprint parts of a task whose inputs are all known; whether its own output is needed
    again is not asked."""
    parts = all_parts(book.context, task, own_parts(book.context, task), digests)
    receipt = book.receipts.get(task)
    forced = selection.forced(task.stage)
    if receipt is None:
        return State.STALE, ("never made",), parts
    as_kept = still_good(parts, receipt.parts)
    same = receipt.parts == as_kept or receipt.fingerprint == digest(as_kept)
    why = [] if same else reasons(book.context, receipt.parts, parts) or ["its fingerprint changed"]
    why = why or [f"{name} is asked for" for name in lacking(book.context, task, receipt)]
    why += [book.problems[task]] if task in book.problems else []
    why += [forced] if forced else []
    return (State.STALE, tuple(why), parts) if why else (State.FRESH, (), as_kept)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Without the cyclic collector: a plan makes many small objects and no cycles, and looking through them took a
    quarter of its time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@_uncollected()
def make_plan(
    context: Context,
    selection: Selection = Selection(),
    wanted: Callable[[Context], frozenset[Product]] | None = None,
) -> Plan:
    """Judge every task of a sequence. Reads receipts and file sizes only.

    `wanted`: products that must be there afterwards, whatever `keep` says; of sequence-wide stages, they are asked for
    thereby.
    """
    held = wanted(context) if wanted else frozenset()
    constants = frozenset(p.array for p in held if p.array in PRODUCERS and PRODUCERS[p.array][0].sequence_wide)
    named = selection.only | selection.force
    context = replace(context, exported=constants, named=named) if constants or named else context
    book = Book.open(context, held)
    context = decided(book, selection)
    if wanted and wanted(context) != held:
        book = Book.open(context, wanted(context))
    verdicts: dict[Task, TaskVerdict] = {}
    for task in tasks(context):
        waiting = [d for d in dependencies(context, task) if d not in verdicts or verdicts[d].state not in READY]
        if waiting:
            verdicts[task] = _before_inputs(book, task, selection, waiting)
            continue
        digests = book.digests(task)
        assert digests is not None, f"{task.label()}: all inputs are fresh, but an output is missing from a receipt"
        state, why, parts = judge(book, task, selection, digests)
        if state is State.STALE and _keeps(book, task, selection, parts):
            state, why = State.KEPT, (TAKEN_OVER,)
        verdicts[task] = TaskVerdict(task, state, why)
    _call_back(book, verdicts)
    return Plan(context, book, verdicts, context.unneeded(), selection, wanted)


def lacking(context: Context, task: Task, receipt: Receipt) -> list[str]:
    """Outputs that a task is to make and that its receipt does not have: what is written hangs on more facts than a
    fingerprint holds, such as whether Gaussians have a twist. Those of sequence-wide stages are compared there."""
    stage, made = stage_named(task.stage), {o.array for o in receipt.outputs}
    names = [w.name.format(path=task.path or "") for w in stage.writes_for(context.facts)]
    return [] if stage.sequence_wide else [name for name in names if name not in made]


def kept_result(context: Context, task: Task, selection: Selection, parts: Mapping[str, Any]) -> Receipt | None:
    """What an earlier run made with these fingerprint parts, where it was put aside and may be taken over.

    Fingerprints of sequence-wide constants leave the sources out; of these only what was taken of the same pictures
    counts.
    """
    if not context.settings.run.kept_bytes or selection.forced(task.stage) or not selection.allows(task.stage):
        return None
    receipt = set_aside.find(context.sequence, ReceiptKey(*task[1:]), digest(parts))
    if (
        receipt is not None
        and stage_named(task.stage).sequence_wide
        and receipt.facts.get("sources") != pictures_digest(context, task)
    ):
        return None
    return None if receipt is not None and lacking(context, task, receipt) else receipt


def pictures_digest(context: Context, task: Task) -> str:
    """Digest of the pictures that a sequence-wide task is made from: its view's, or those of all source views."""
    views = context.views.sources if task.view is None else (task.view,)
    found = [context.capture.pictures[v].digest(context.capture.numbers) for v in views]
    return found[0] if task.view is not None else digest(found)


def of_other_pictures(context: Context, task: Task, receipt: Receipt) -> bool:
    """Whether a constant of the sequence was taken of other pictures than the capture has now; unknown of receipts of
    earlier versions, which count as taken of the same."""
    return receipt.facts.get("sources") not in (None, pictures_digest(context, task))


def _keeps(book: Book, task: Task, selection: Selection, parts: Mapping[str, Any]) -> bool:
    """Whether a stale task will be taken over; the book counts on it from then on."""
    receipt = kept_result(book.context, task, selection, parts)
    if receipt is not None:
        book.kept[task] = receipt
    return receipt is not None


def decided(book: Book, selection: Selection = Selection()) -> Context:
    """The book's context with the decisions that sequence-wide stages lead to, as far as these are fresh; the book
    goes on with it."""
    while more := _notes_waited_for(book, selection):
        book.context = book.context.with_noted({**book.context.noted, **more})
    return book.context


def take_decisions(plan: Plan) -> tuple[EffectVerdict | ChoiceVerdict, ...]:
    """Go on with the decisions that sequence-wide stages lead to which just ran; returns what was decided now.

    Raises ValueError where all that a decision asked for is noted and it cannot be made.
    """
    waited, open_cameras = plan.context.verdicts.open, plan.context.cameras_undecided
    before = plan.context.paths.keys(), plan.context.views
    plan.context = decided(plan.book)
    plan.unneeded = plan.context.unneeded()
    if plan.wanted is not None and (plan.context.paths.keys(), plan.context.views) != before:
        plan.book = Book.open(plan.context, plan.wanted(plan.context))
    now = plan.context.verdicts
    stuck = {_name(v): v.asks for v in now.open}
    stuck |= {"which cameras are believed": TRUST.asks} if open_cameras and plan.context.cameras_undecided else {}
    for name, asks in stuck.items():
        if set(asks) <= plan.context.noted.keys():
            stages = " and ".join(dict.fromkeys(PRODUCERS[a][0].name for a in asks))
            raise ValueError(
                f"{stages} of {plan.context.sequence.name} ran, but {name} cannot be decided by it; `run --from"
                f" {PRODUCERS[asks[0]][0].name}` takes it anew"
            )
    undecided = {_name(v) for v in now.open}
    every: dict[str, EffectVerdict | ChoiceVerdict] = {**now.effects, **now.choices}
    return tuple(every[_name(v)] for v in waited if _name(v) in every and _name(v) not in undecided)


def _name(verdict: EffectVerdict | ChoiceVerdict) -> str:
    return verdict.name if isinstance(verdict, ChoiceVerdict) else verdict.effect.name


def _notes_waited_for(book: Book, selection: Selection) -> dict[str, Any]:
    """What is noted by now of the arrays that decisions wait for; nothing of a stage that has a task to do, nor of one
    that must know which cameras are believed before that is decided."""
    context, found = book.context, {}
    waited = dict.fromkeys(a for asks in context.waits.values() for a in asks)
    for stage in (s for s in STAGES if s.sequence_wide and (s.trust is not None or not context.cameras_undecided)):
        arrays = tuple(a for a in waited if PRODUCERS[a][0].name == stage.name)
        if arrays and all(_is_ready(book, t, selection) for t in measuring(context, stage)):
            receipts = [r for t in measuring(context, stage) if (r := book.expected(t)) is not None]
            found.update(noted(receipts, arrays, "view" in stage.over) or {})
    return found


def _is_ready(book: Book, task: Task, selection: Selection) -> bool:
    """Whether a task's output is there, or will be taken over."""
    digests = book.digests(task)
    if digests is None:
        return False
    state, _, parts = judge(book, task, selection, digests)
    return state is State.FRESH or _keeps(book, task, selection, parts)


def _call_back(book: Book, verdicts: dict[Task, TaskVerdict]) -> None:
    """Fresh tasks whose dropped outputs an export or what is not fresh reads: stale, or undecided like their readers.

    Readers come before what they read, so that a task called back calls back its own dropped inputs. What else read the
    output stays fresh: the same content is expected, and a run looks again if it comes out different.
    """
    dropped = book.has_dropped  # listing what every task reads takes as long as judging it
    for task in reversed(list(verdicts)):
        if task in book.needed and verdicts[task].state is not State.STALE:
            verdicts[task] = TaskVerdict(task, State.STALE, (book.needed[task],))
        state = verdicts[task].state
        if state in READY:
            continue
        for maker in book.dropped_inputs(task) if dropped else ():
            if verdicts[maker].state is State.FRESH or (
                state is State.STALE and verdicts[maker].state is State.UNDECIDED
            ):
                why = (
                    f"its output was dropped and is needed by {task.stage}"
                    if state is State.STALE
                    else f"its output was dropped; it is made again if {task.stage} turns out to need it"
                )
                verdicts[maker] = TaskVerdict(maker, state, (why,))


def _before_inputs(book: Book, task: Task, selection: Selection, waiting: Iterable[Task]) -> TaskVerdict:
    """A task whose inputs are not all fresh: stale if its own parts already say so, else undecided."""
    receipt = book.receipts.get(task)
    stages = " and ".join(dict.fromkeys(d.stage for d in waiting))
    if receipt is None:
        return TaskVerdict(task, State.STALE, ("never made",))
    why = reasons(book.context, receipt.parts, own_parts(book.context, task))
    why += [book.problems[task]] if task in book.problems else []
    forced = selection.forced(task.stage)
    why += [forced] if forced else []
    if why:
        return TaskVerdict(task, State.STALE, tuple(why))
    return TaskVerdict(
        task, State.UNDECIDED, (f"waits for {stages}; if its content comes out equal, nothing is done here",)
    )


def _notes(context: Context, book: Book, fresh: Collection[Task]) -> tuple[str, ...]:
    """Sequence-wide constants that stay though they were taken from other files than the capture has now, cameras of
    paths that are left out, and what each stage says of these settings."""
    found = []
    for s in STAGES:
        if not s.sequence_wide:
            continue
        changed = [
            "a source view" if t.view is None else context.views.names[t.view]
            for t in tasks_of(context, s)
            if t in fresh and of_other_pictures(context, t, book.receipts[t])
        ]
        if changed:
            found.append(
                f"{s.name} was taken before the pictures of {', '.join(changed)} changed and is kept; `run --from"
                f" {s.name}` takes it anew"
            )
    found += _changed_sources(context)
    found += [v.sentence for v in context.cameras.values() if v.overruled]
    for path in context.paths.values():
        idle = [name for name, served in zip(path.names, np.any(path.served, axis=0), strict=True) if not served]
        if idle:
            found.append(
                f"camera path {path.text!r}: {', '.join(idle)} serve no frame of"
                f" {context.source_frames[0]}..{context.source_frames[-1]} and are left out; see frames.range"
            )
    gone = context.unneeded()
    for s in STAGES:
        if s.name not in gone:
            found += s.notes(replace(context.evidence(s.name), facts=context.facts))
    return tuple(found)


def _changed_sources(context: Context) -> list[str]:
    """A sentence about files that are not what was imported; what was made from them stays as it is until they are
    imported again."""
    changed = [f.path for f in context.capture.files if f.touched]
    if not changed:
        return []
    more = f" and {len(changed) - 1} more source files" if len(changed) > 1 else ""
    warning = (
        f"{changed[0]}{more} changed or went away since the import (size or time differ); what was made from the old"
        " content stays until `posegaussian import` takes the new one"
    )
    return [warning]
