"""Why a task would run: the chain back to the first cause, and at every step what differs from when it was last
made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from posegaussian.dags.planning.fingerprint import all_parts, own_parts
from posegaussian.dags.planning.plan import Plan, State, TaskVerdict, told
from posegaussian.dags.planning.tasks import Task, dependencies
from posegaussian.storage.archive.receipts import Receipt


def why(plan: Plan, task: Task) -> list[str]:
    """The chain of reasons of a task, from itself back to the first stale inputs, indented by depth.

    Every task that is not fresh is followed by when and where it was last made, what was accepted, and each fingerprint
    part that differs, old -> new. Of a fresh task the acceptances alone are told.
    """
    lines: list[str] = []
    seen: set[Task] = set()

    def visit(t: Task, depth: int) -> None:
        verdict = plan.verdicts[t]
        seen.add(t)
        indent = "  " * depth
        lines.append(
            f"{indent}{t.label(plan.context.views.names)}: {verdict.state.value}"
            + (f" ({'; '.join(verdict.reasons)})" if verdict.reasons else "")
        )
        lines.extend(f"{indent}    {line}" for line in _past(plan, t))
        for d in dependencies(plan.context, t):
            if d in plan.verdicts and plan.verdicts[d].state is not State.FRESH and d not in seen:
                visit(d, depth + 1)

    visit(task, 0)
    return lines


def first_cause(plan: Plan, tasks: Sequence[Task]) -> str:
    """One line on tasks of a stage that are not fresh: the reason to which all of them go back, or most."""
    stale = [t for t in not_fresh(plan, tasks) if plan.verdicts[t].state is State.STALE] or tasks
    stage = stale[0].stage
    (reasons, _) = Counter(plan.verdicts[t].reasons for t in stale if t.stage == stage).most_common(1)[0]
    because = "" if stage == tasks[0].stage else f" because of {stage}"
    return f"{tasks[0].stage} is not fresh{because}: {reasons[0]}"


def by_stage(plan: Plan, tasks: Sequence[Task]) -> list[str]:
    """One line for every stage on the way back from tasks that are not fresh: how many, and why."""
    found: dict[str, list[TaskVerdict]] = {}
    for t in not_fresh(plan, tasks):
        found.setdefault(t.stage, []).append(plan.verdicts[t])
    return [f"{stage}, {_states(some)}: {told(some)}" for stage, some in found.items()]


def not_fresh(plan: Plan, tasks: Sequence[Task]) -> list[Task]:
    """Tasks, and all that they wait for that is not fresh either, in the order of flow."""
    found, waiting = set(tasks), list(tasks)
    for t in waiting:  # grows while it is walked through
        for d in dependencies(plan.context, t):
            if d in plan.verdicts and plan.verdicts[d].state is not State.FRESH and d not in found:
                found.add(d)
                waiting.append(d)
    return [t for t in plan.verdicts if t in found]


def _states(verdicts: Iterable[TaskVerdict]) -> str:
    return ", ".join(f"{n} {state.value}" for state, n in Counter(v.state for v in verdicts).items())


def _past(plan: Plan, task: Task) -> Iterator[str]:
    receipt = plan.book.receipts.get(task)
    if receipt is None:
        return
    yield from acceptances(receipt)
    if plan.verdicts[task].state is State.FRESH:
        return
    yield (
        f"last made {receipt.facts.get('started', 'at an unknown time')} on"
        f" {receipt.facts.get('host', 'an unknown machine')}"
    )
    own, digests = own_parts(plan.context, task), plan.book.digests(task)
    now = own if digests is None else all_parts(plan.context, task, own, digests)
    yield from differences({k: receipt.parts.get(k) for k in now}, now)


def acceptances(receipt: Receipt) -> Iterator[str]:
    """Sentences about the acceptances of a receipt, oldest first."""
    for note in receipt.facts.get("accepted", []):
        yield (
            f"accepted {note['when']} by {note['by']}: {note['reason']} ({'; '.join(note['changed']) or 'no change'};"
            f" fingerprint was {note['from'][:8]})"
        )


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """`part: old -> new` of every fingerprint part that differs, mappings entry by entry, digests by their first
    digits."""
    for key in sorted({*old, *new}):
        a, b = old.get(key), new.get(key)
        if a == b:
            continue
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            yield from differences(a, b, f"{prefix}{key}: ")
        else:
            yield f"{prefix}{key}: {_short(a)} -> {_short(b)}"


def _short(value: Any) -> str:
    text = "nothing" if value is None else f"{value}"
    if len(text) == 32 and all(c in "0123456789abcdef" for c in text):
        return text[:8]
    return text if len(text) <= 60 else text[:57] + "..."
