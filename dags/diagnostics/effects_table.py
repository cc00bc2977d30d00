"""The effects of a sequence as a table:
what was measured, what follows from it and why, and what that saves or costs."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from posegaussian.dags.planning.effects import EffectVerdict
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.task_cost import load
from posegaussian.dags.planning.tasks import PRODUCERS, tasks_of
from posegaussian.stages.contract.declaration import Stage
from posegaussian.stages.registry import STAGES, TRUST
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.model.spec import digest


def effects_table(plan: Plan, timed: Sequence[Mapping[str, Any]] = ()) -> Table:
    """One row an effect, then one a choice (where masks come from), each with its reason below; `timed`: finished
    tasks as `History.timed` has them, for the seconds."""
    table = Table(
        title=f"{escape(plan.context.sequence.name)}: effects",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for column, justify in (
        ("effect", "left"),
        ("measured", "right"),
        ("bound", "right"),
        ("state", "left"),
        ("time", "right"),
    ):
        table.add_column(column, justify=justify, no_wrap=True)  # type: ignore[arg-type]
    for v in plan.context.effects.values():
        table.add_row(
            v.effect.name,
            _measured(v),
            v.effect.quantity(f"{v.effect.threshold:g}"),
            _state(v),
            _time(v, seconds(plan, v, timed)),
        )
    measured, state, _ = _cameras(plan)
    table.add_row("views.trust", measured, f"{TRUST.bound:g} {TRUST.unit}", escape(state), "")
    for name, answer, setting, _ in _choices(plan):
        table.add_row(name, "", "", f"{answer} ({'auto' if setting == 'auto' else 'forced'})", "")
    return table


def effects_reasons(plan: Plan, every: bool = True) -> list[str]:
    """`NAME state: why`, one sentence for every row of the table; else of what changes the pictures: what is on,
    forced or chosen."""
    effects = [v for v in plan.context.effects.values() if every or v.state == "on" or v.setting != "auto"]
    told = [f"{v.effect.name} {v.state}: {_why(v)}" for v in effects]
    cameras = list(plan.context.cameras.values())
    told += [_cameras(plan)[2]] if not every or plan.context.cameras_undecided else [v.sentence for v in cameras]
    return told + [f"{name} {answer}: {why}" for name, answer, _, why in _choices(plan)]


def _cameras(plan: Plan) -> tuple[str, str, str]:
    """What was measured of the camera that agrees least, which cameras are believed, and why."""
    cameras = plan.context.cameras
    setting = plan.context.settings.views.trust
    how = setting if isinstance(setting, str) else f"auto, {', '.join(setting)} forced"
    if plan.context.cameras_undecided:
        why = "views.trust undecided: known once the survey compared what the cameras see"
        return "after survey", f"undecided ({how})", why
    found = [v.belief.measured for v in cameras.values() if v.belief is not None and v.belief.measured is not None]
    out = [name for name, v in cameras.items() if v.state == "left out"]
    state = f"{len(cameras) - len(out)} of {len(cameras)} ({how})"
    return (
        f"{max(found):.3g} {TRUST.unit}" if found else "",
        state,
        "; ".join(v.sentence for v in cameras.values() if v.overruled)
        or f"views.trust: {'all cameras are' if len(cameras) > 1 else 'the camera is'} believed",
    )


def _choices(plan: Plan) -> Iterator[tuple[str, str, str, str]]:
    """(name, answer, setting, why) of every choice."""
    for stage in STAGES:
        for choice in stage.choices:
            params, name = plan.context.params(stage), f"{stage.name}.{choice.setting}"
            answer, why = choice.resolve(params, plan.context.facts)
            measured = plan.context.choices.get(name)
            if measured is not None:
                answer = answer if measured.picked else "undecided"
                why = measured.picked.reason if measured.picked else f"known once {_awaited(measured.asks)} ran"
            yield name, str(answer), str(getattr(params, choice.setting)), why


def _measured(v: EffectVerdict) -> str:
    if v.decision is None:
        return f"after {_awaited(v.asks).rpartition(' and ')[2]}"
    return "" if v.decision.measured is None else v.effect.quantity(f"{v.decision.measured:.3g}")


def _state(v: EffectVerdict) -> str:
    return "undecided (auto)" if v.decision is None else f"{v.state} ({'auto' if v.setting == 'auto' else 'forced'})"


def _why(v: EffectVerdict) -> str:
    return v.decision.reason if v.decision else f"{v.effect.measure}: known once {_awaited(v.asks)} ran"


def _awaited(asks: tuple[str, ...]) -> str:
    """`survey and judge`: the stages whose outputs are asked for."""
    return " and ".join(dict.fromkeys(PRODUCERS[a][0].name for a in asks))


def _time(v: EffectVerdict, spent: float | None) -> str:
    if v.decision is None or spent is None:
        return "unknown"
    amount = f"{abs(spent):.2g} s"
    return f"spends {amount}" if v.decision.on == (spent >= 0) else f"saves {amount}"


def seconds(plan: Plan, verdict: EffectVerdict, timed: Sequence[Mapping[str, Any]]) -> float | None:
    """Seconds that an effect costs while it is on, over all tasks of its stages, one after the other; None where
    unknown.

    From the archive's finished tasks with the same settings, with and without the effect: median seconds per unit of
    work. A stage that is not needed without the effect costs nothing then. Tasks that differ in another effect are not
    told apart.
    """
    total = 0.0
    for name in verdict.stages:
        stage = stage_named(name)
        if name in plan.unneeded and not _depends(plan, stage, verdict.effect.name):
            continue
        found = _rates(plan, stage, verdict.effect.name, timed)
        if found is None:
            return None
        work = sum(load(plan.context, t).work for t in tasks_of(plan.context, stage))
        total += work * (found[0] - found[1])
    return total


def _rates(plan: Plan, stage: Stage, effect: str, timed: Sequence[Mapping[str, Any]]) -> tuple[float, float] | None:
    """Seconds per unit of work of a stage's tasks with and without an effect."""
    now = digest(plan.context.params(stage).hashed())
    of_stage = [r for r in timed if r["stage"] == stage.name and r["params"] == now]
    with_it = [r["seconds"] / r["work"] for r in of_stage if effect in (r.get("effects") or "").split()]
    without = [r["seconds"] / r["work"] for r in of_stage if effect not in (r.get("effects") or "").split()]
    if _depends(plan, stage, effect):
        without = [0.0]
    return (statistics.median(with_it), statistics.median(without)) if with_it and without else None


def _depends(plan: Plan, stage: Stage, effect: str) -> bool:
    """Whether the whole stage is needed for the effect alone."""
    params, facts = plan.context.params(stage), plan.context.facts
    return stage.unneeded(params, facts | {effect}) is None and stage.unneeded(params, facts - {effect}) is not None
