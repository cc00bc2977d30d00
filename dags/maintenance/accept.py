"""Keeping outputs after a change that cannot matter: their receipts get the fingerprint of today, and say who decided
so.

Only a stage's version, code and settings may have changed. What it read (sources, inputs, cameras, frames) must be the
same, and its shards must be there: nobody can vouch for those.
"""

from __future__ import annotations

import getpass
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from posegaussian.dags.planning.fingerprint import reasons
from posegaussian.dags.planning.plan import Plan, State, judge
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task, dependencies
from posegaussian.dags.runtime import run_registry
from posegaussian.stages.registry import ASSETS, STAGES
from posegaussian.storage.archive.lease import Lease, own_name
from posegaussian.storage.archive.receipts import Receipt, ReceiptKey, lease_file, read_receipt, write_receipt
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.spec import digest

HARMLESS = ("version", "code", "params")
"""Fingerprint parts whose change may be accepted."""
OF_THE_PROGRAM = ("version", "code")
"""Those of them that no setting changes: what may be accepted of all stages at once."""
EVERY = "all"
"""Stands for every stage."""


def accept_every(plan_of: Callable[[], Plan], reason: str) -> list[str]:
    """`accept` for every stage that has outputs, in the order of flow, after another version of the program.

    Args:
        plan_of: makes the plan anew: once a stage is accepted, those behind it can be judged.
        reason: why the change cannot matter.

    Raises:
        UserError: as `accept` does, and for settings that changed; what was accepted until then stays so.
    """
    said = []
    for stage in STAGES:
        plan = plan_of()
        if stage.name not in plan.unneeded and any(t.stage == stage.name for t in plan.book.receipts):
            said += accept(plan, stage.name, reason, OF_THE_PROGRAM)
    return said


def accept(plan: Plan, stage: str, reason: str, harmless: tuple[str, ...] = HARMLESS) -> list[str]:
    """Re-key the receipts of a stage's stale tasks; returns sentences about what was done.

    Nothing is written before every task was looked at. Tasks that were never made stay so.

    Raises:
        UserError: no reason, a stage the capture does not need, an upstream stage that is not fresh, a missing shard,
            or a change of something other than version, code and settings.
        LeaseHeld: a run works on the sequence.
    """
    name = plan.context.sequence.name
    if not reason.strip():
        raise UserError("accept: --reason must say why the change cannot matter; it is kept in the receipts")
    if stage in plan.unneeded:
        raise UserError(f"accept: {name} does not need {stage}: {plan.unneeded[stage]}")
    settled = _settled(plan)
    stale = [t for t in plan.verdicts if t.stage == stage and t not in settled]
    if not stale:
        return [f"{name}: {stage} is fresh, there is nothing to accept"]
    made = [t for t in stale if t in plan.book.receipts]
    keyed = [_keyed(plan, task, settled, reason.strip(), harmless) for task in made]
    run_registry.refuse_busy(plan.context.sequence, "accept")
    for task, (receipt, _) in zip(made, keyed, strict=True):
        _replace(plan, task, receipt)
    changes = ", ".join(dict.fromkeys(c for _, changed in keyed for c in changed)) or "no change"
    said = [f"{name}: accepted {len(made)} of {len(stale)} stale outputs of {stage}: {changes}"]
    if len(made) < len(stale):
        said.append(f"{name}: {len(stale) - len(made)} outputs of {stage} were never made; a run makes them")
    return said


def _replace(plan: Plan, task: Task, receipt: Receipt) -> None:
    """Write a task's receipt in the place of the one that was planned with.
    Raises UserError where a run replaced that, LeaseHeld while one works on the task."""
    sequence, key = plan.context.sequence, ReceiptKey(*task[1:])
    with Lease.take(lease_file(sequence, key), own_name("accept")):
        if read_receipt(sequence, key) != plan.book.receipts[task]:
            raise UserError(
                f"accept: {sequence.name} {task.label()} was made anew by a run in the meantime; look again with"
                f" `posegaussian why {sequence.name} {task.stage}`"
            )
        write_receipt(sequence, receipt)
    plan.book.add(task, receipt)


def _settled(plan: Plan) -> set[Task]:
    """Tasks that are fresh by themselves: also those whose dropped bytes the plan has made again for a stale stage."""
    settled: set[Task] = set()
    for task in plan.verdicts:
        if all(d in settled for d in dependencies(plan.context, task) if d in plan.verdicts):
            digests = plan.book.digests(task)
            if digests is not None and judge(plan.book, task, Selection(), digests)[0] is State.FRESH:
                settled.add(task)
    return settled


def _without_code_of_assets(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Fingerprint parts but for the digests of assets that have code of ours in them, such as the pose estimator.

    Whoever accepts other code vouches for that, too; the receipt names it among what changed.
    """
    coded = {name for name, (_, asset) in ASSETS.items() if asset.code is not None}
    return {**parts, "sources": {k: v for k, v in parts.get("sources", {}).items() if k not in coded}}


def _keyed(
    plan: Plan, task: Task, settled: set[Task], reason: str, harmless: tuple[str, ...]
) -> tuple[Receipt, list[str]]:
    """The receipt under today's fingerprint, and what changed since it was written.
    Raises UserError when that may matter."""
    name, old = plan.context.sequence.name, plan.book.receipts[task]
    label = f"accept: {name} {task.label(plan.context.views.names)}"
    if task in plan.book.problems:
        raise UserError(
            f"{label}: {plan.book.problems[task]}; what is not there cannot be accepted, run again to make it"
        )
    digests = plan.book.digests(task)
    before = [d.stage for d in dependencies(plan.context, task) if d in plan.verdicts and d not in settled]
    if digests is None or before:
        raise UserError(
            f"{label}: what it reads of {' and '.join(dict.fromkeys(before))} is not fresh; accept or run that first"
            f" (`posegaussian why {name} {task.stage}`)"
        )
    _, _, parts = judge(plan.book, task, Selection(), digests)
    was, now = _without_code_of_assets(old.parts), _without_code_of_assets(parts)
    other = [k for k in sorted({*was, *now}) if k not in harmless and was.get(k) != now.get(k)]
    changed = reasons(plan.context, old.parts, parts)
    if other:
        raise UserError(
            f"{label}: {', '.join(other)} changed, not only {', '.join(harmless)} ({'; '.join(changed)});"
            " run it instead"
        )
    note = {
        "by": getpass.getuser(),
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "from": old.fingerprint,
        "changed": changed,
        "reason": reason,
    }
    return (
        replace(
            old,
            fingerprint=digest(parts),
            parts=parts,
            facts={**old.facts, "accepted": [*old.facts.get("accepted", []), note]},
        ),
        changed,
    )
