"""`posegaussian evaluate`: methods on sequences with held-out cameras, in one protocol, and the table of it.

Everything is made by the pipeline's own planning, ours in the archive, the others in variants of it, so that what is
there is not computed anew and methods share what they have in common.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from posegaussian.dags.diagnostics.held_out_quality import held_out_path
from posegaussian.dags.evaluation.measured import hidden_pictures, pictures
from posegaussian.dags.evaluation.methods import OURS, Method
from posegaussian.dags.evaluation.results import Result, data_set, with_means
from posegaussian.dags.evaluation.spent import MEASURES, costs, hosts
from posegaussian.dags.evaluation.tables import definitions, latex, markdown, rows
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.variants import settled_variant
from posegaussian.dags.runtime.signals import STATUS as INTERRUPTED
from posegaussian.dags.session.session import Session
from posegaussian.dags.tradeoff.tradeoff import write_parquet
from posegaussian.stages.metrics.measures.registry import METRICS
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import ConfigError, UserError

PATHS = ("held_out",)
NAME = "evaluation"
"""Of the files."""


@dataclass(frozen=True)
class Evaluation:
    """What came of a call."""

    results: list[Result]
    """Of every sequence and method, by sequence, then the means."""
    protocol: str
    """One sentence: what was compared with what; empty where nothing could be planned."""
    status: int
    """0 all done, 1 something failed, 130 interrupted: there are no results then."""


def measurable(session: Session, globs: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of the sequences that a glob matches, all without globs, and that have held-out cameras; and a sentence for
    each that cannot be read. Those without held-out cameras are told.

    Raises ConfigError where none has any, ArchiveError where a glob matches none.
    """
    seeing, blind, refused = list[str](), dict[str, str](), list[str]()
    for name in session.names(globs):
        try:
            context = Context(session.archive.sequence(name), session.configuration.for_sequence(name), ())
            if context.held_out:
                seeing.append(name)
            else:
                blind[name] = context.capture.rig.names[-1]
        except UserError as e:
            refused.append(f"{name}: {e}")
    if not seeing:
        raise ConfigError("\n".join([*refused, *_without_camera(blind)]))
    session.say((f"{n}: left out, it has no held-out camera (views.held_out names some)" for n in blind), "yellow")
    return seeing, refused


def _without_camera(blind: Mapping[str, str]) -> list[str]:
    """What to do for sequences without a held-out camera, if there are any: {sequence: a camera that could be it}."""
    if not blind:
        return []
    first, last = next(iter(blind.items()))
    alone = "" if len(blind) == 1 else f" and {first} alone"
    sentence = (
        f"evaluate: {', '.join(blind)}: no held-out camera to measure against; name cameras to keep aside, for"
        f" example --set 'views.held_out=[{last}]'{alone}"
    )
    return [sentence]


def evaluate(session: Session, names: Sequence[str], methods: Sequence[Method]) -> Evaluation:
    """Run what is missing, method by method, and gather what each came to: a method that a sequence cannot have is
    named, and the others go on. Raises ConfigError for settings that cannot be."""
    found: dict[tuple[str, str], Result] = {}
    contexts: dict[str, Context] = {}
    status = 0
    for method in methods:
        session.hint([f"{method.name}: {method.summary}"])
        plans, came = _run(session, names, method)
        if came == INTERRUPTED:
            return Evaluation([], "", came)
        status = max(status, came)
        for name, plan in plans.items():
            kind = data_set(session.archive.sequence(name).capture)
            found[name, method.name] = _result(name, kind, method, plan)
            if isinstance(plan, Plan):
                contexts.setdefault(name, plan.context)
    results = [found[n, m.name] for n in names for m in methods]
    return Evaluation(with_means(results), protocol(contexts, results) if contexts else "", status)


def _run(session: Session, names: Sequence[str], method: Method) -> tuple[dict[str, Plan | str], int]:
    """The method's plans by sequence after its run, a sentence for one that cannot be planned; and the exit status."""
    configuration = method.over(session.configuration)
    own, why = replace(session, configuration=configuration), dict[str, str]()
    for name in names if method.name != OURS else ():
        try:
            settings = configuration.for_sequence(name)
            made = settled_variant(session.archive.sequence(name), settings, method.different, PATHS)
            own = replace(own, archive_url=str(made.sequence.root.parent))
        except UserError as e:
            why[name] = str(e)
    plans, refused = own.planned([n for n in names if n not in why], PATHS, Selection())
    status = own.run_and_report(plans, Selection()) if plans else 0
    if status == INTERRUPTED:
        return {}, status
    # an effect that was decided meanwhile may be one that a stage refuses
    plans, later = own.planned([p.context.sequence.name for p in plans], PATHS, Selection())
    why |= refused | later
    session.say((f"{name}: {method.name}: {text}" for name, text in why.items()), "red")
    return {**{p.context.sequence.name: p for p in plans}, **why}, 1 if why else status


def _result(name: str, kind: str, method: Method, plan: Plan | str) -> Result:
    if isinstance(plan, str):
        return Result(name, kind, method.name, why=plan)
    if not plan.all_fresh:
        return Result(name, kind, method.name, why="a task failed; the run says which, and how it is tried again")
    measured = [t for t in plan.verdicts if t.stage == MEASURES]  # receipts may lie there of frames not worked on now
    table = Results(plan.context, plan.book).rows(o for t in measured for o in plan.book.receipts[t].outputs)
    numbers = [*pictures(table), *costs(plan)]
    return Result(
        name,
        kind,
        method.name,
        {n.key: n for n in numbers},
        hosts=tuple(hosts(plan)),
        empty=_empty(plan.context, table),
        hidden=hidden_pictures(table),
    )


def _empty(context: Context, table: Sequence[Mapping[str, Any]]) -> int:
    """Pictures that held-out cameras filmed and that have no rows in the metrics' table: nobody is in them."""
    if all(METRICS[m].change_of for m in context.settings.metrics.measures):
        return 0  # a first frame has no rows either
    path = held_out_path(context)
    filmed = path.served & context.valid[:, [context.rig.index(name) for name in path.names]]
    return int(filmed.sum()) - len({(row["camera"], row["frame"]) for row in table})


def protocol(contexts: dict[str, Context], results: Sequence[Result]) -> str:
    """One sentence: views, size, background, regions, LPIPS' network, and where seconds come from."""
    views: dict[str, list[str]] = {}
    for name, c in contexts.items():
        path = held_out_path(c)
        sizes = ", ".join(dict.fromkeys(f"{w} x {h}" for w, h in path.size.tolist()))
        told = f"{', '.join(path.names)} ({sizes} px, {len(c.views.sources)} source views, {c.grid.frames} frames)"
        views.setdefault(told, []).append(name)
    held = "; ".join(f"{told} of {', '.join(of)}" for told, of in views.items())
    measured = {k[0] for r in results for k, n in r.numbers.items() if n.value is not None}
    networks = [n for m, n in (("lpips_alex", "AlexNet"), ("lpips_vgg", "VGG16")) if m in measured]
    lpips = f"LPIPS is version 0.1 on {' and '.join(networks)}" if networks else "LPIPS was not measured"
    machines = "; ".join(dict.fromkeys(h for r in results for h in r.hosts)) or "no machine"
    return (
        f"Protocol: what held-out cameras filmed ({held}) is compared with what is rendered for them, both on black"
        " (the truth times its own soft mask), over the full picture, the bounding box of the mask, and the mask's own"
        f" pixels (above 127 of 255); {lpips}; numbers are means over pictures, those of several sequences means over"
        f" sequences; seconds are wall seconds of tasks, one at a time a worker, on {machines}."
    )


def run_evaluate(session: Session, globs: Sequence[str], methods: Sequence[Method], output: Path) -> int:
    """The command: run, print the table, write it as Parquet, Markdown and LaTeX; returns the exit status, 1 also where
    a sequence could not be read: it is named, and the others are measured.

    Raises ConfigError and ArchiveError for sequences and settings that cannot be, NotWritten.
    """
    names, refused = measurable(session, globs)
    session.say(refused, "red")
    session.say(session.configuration.idle(session.archive.names()), "yellow")
    try:
        made = evaluate(session, names, methods)
    except UserError as e:
        raise ConfigError(f"evaluate: {e}") from e
    if made.status == INTERRUPTED:
        return made.status
    if not made.protocol:
        raise ConfigError("\n".join(dict.fromkeys(f"{r.sequence}: {r.why}" for r in made.results if r.data_set)))
    page = markdown(made.results, made.protocol)
    session.say(page)
    told = ["", "What each number is:", "", *definitions(made.results)]
    write_atomically(output / f"{NAME}.md", "\n".join([*page, *told, ""]).encode())
    write_atomically(output / f"{NAME}.tex", "\n".join([*latex(made.results, made.protocol), ""]).encode())
    write_parquet(output / f"{NAME}.parquet", rows(made.results), {"protocol": made.protocol})
    session.say([f"table: {output / NAME}.md, .tex and .parquet (with every number's definition)"])
    session.say([following(session, globs, names[0], methods)])
    return 1 if refused else made.status


def following(session: Session, globs: Sequence[str], sequence: str, methods: Sequence[Method]) -> str:
    """The next useful command: other methods beside ours, else what seconds buy."""
    if [m.name for m in methods] == [OURS]:
        return next_command("evaluate", *globs, *session.options, "--methods", f"{OURS},hull")
    return next_command("tradeoff", "--knob", "depth.method", "--sequence", sequence, *session.options)
