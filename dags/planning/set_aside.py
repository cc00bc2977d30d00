"""What a run is about to replace: put aside within a budget of bytes, so that going back to a setting computes
nothing."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from posegaussian.dags.planning.plan import Plan, State
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive import set_aside
from posegaussian.storage.archive.deletion import bytes_of
from posegaussian.storage.archive.receipts import Receipt
from posegaussian.storage.model.spec import ArraySpec


def replaced(plan: Plan, lost: Collection[str] = ()) -> Iterator[Receipt]:
    """Whole results that a run of the plan replaces, at most; not those that it was told to make anew.

    lost: arrays that are replaced as a whole, with results of partitions that are not in the plan.
    """
    for task, receipt in plan.book.receipts.items():
        verdict = plan.verdicts.get(task)
        goes = (
            verdict.state is not State.FRESH if verdict is not None else any(o.array in lost for o in receipt.outputs)
        )
        whole = task not in plan.book.problems and not any(o.dropped for o in receipt.outputs)
        if goes and whole and plan.selection.forced(task.stage) is None and plan.selection.allows(task.stage):
            yield receipt


def destroyed(plan: Plan) -> set[str]:
    """Arrays that are replaced or shortened for these settings: of other partitions, too, results go with them."""
    context, found = plan.context, set()
    for stage in STAGES:
        if stage.name in plan.unneeded or not any(
            v.state is not State.FRESH for v in plan.verdicts.values() if v.task.stage == stage.name
        ):
            continue
        for spec in (w for w in stage.writes_for(context.facts) if isinstance(w, ArraySpec)):
            for path in context.paths if "path" in stage.over else [""]:
                if context.sequence.destroys(spec, context.shape(path or None), path):
                    found.add(spec.name.format(path=path))
    return found


def put_aside(plan: Plan, room: int) -> dict[Path, int]:
    """Link what the run replaces beside the sequence, where there is room for anything.

    Returns {folder: bytes} of what lies aside and will take other bytes than now, as what it links to is replaced or
    taken over: what `shrink` of the archive is to be told.
    """
    sequence = plan.context.sequence
    for task, receipt in plan.book.receipts.items():
        if plan.selection.forced(task.stage) is not None:  # whoever forces a stage does not trust what it made
            set_aside.forget(sequence, set_aside.key_of(receipt), receipt.fingerprint)
    receipts = list(replaced(plan, destroyed(plan)))
    if room:
        set_aside.put(sequence, receipts)
    going = {set_aside.place_of(sequence, r): sum(bytes_of(o.files) for o in r.outputs) for r in receipts}
    coming_back = {set_aside.place_of(sequence, r): 0 for r in plan.book.kept.values()}
    return going | coming_back
