"""What the page says of each sequence, read from settings, receipts, logs, ledger and tables; nothing is computed."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from posegaussian.dags.config.settings import validate
from posegaussian.dags.diagnostics.effects_table import effects_reasons
from posegaussian.dags.diagnostics.other_settings import made_otherwise
from posegaussian.dags.diagnostics.plan_graph import StageCard, cards
from posegaussian.dags.diagnostics.run_log import FailedTask, retry_command, still_failed
from posegaussian.dags.diagnostics.status import Numbers, numbers, rendered_instead
from posegaussian.dags.diagnostics.tables import grouped
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.fingerprint import asked_alike, own_parts
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task, dependencies
from posegaussian.dags.report.changes import changes_of, not_shown
from posegaussian.dags.report.pictures import Drawn, bytes_each, most_changes, pictures_of
from posegaussian.dags.session.session import Session
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import UserError

METRICS = "metrics/{path}"
"""The table of what rendered pictures are worth."""

Curves = dict[str, dict[str, list[tuple[float, float]]]]
"""{measure: {camera: [(source frame, value)]}}."""


@dataclass
class Account:
    """One sequence."""

    name: str
    """As its folder is called."""
    refused: str = ""
    """Why nothing can be said of it."""
    about: str = ""
    """Frames, cameras."""
    made_otherwise: list[str] = field(default_factory=list)
    """A sentence where the last run had other settings: which, and the option that asks for what it made."""
    stages: Numbers = field(default_factory=dict)
    """How many tasks are done, failed, blocked, by stage."""
    plan: list[StageCard] = field(default_factory=list)
    """Every stage, what it makes and who reads that."""
    pictures: list[Drawn] = field(default_factory=list)
    """What can be shown."""
    measures: Curves = field(default_factory=dict)
    """Over the box around the subject, or the whole picture where there is no box."""
    effects: list[str] = field(default_factory=list)
    """A sentence each, with its reason."""
    unseen: list[str] = field(default_factory=list)
    """Effects that are on and that no picture shows."""
    seconds: dict[str, float] = field(default_factory=dict)
    """By stage, of finished tasks; dearest first."""
    failures: list[str] = field(default_factory=list)
    """A sentence each."""
    retry: list[str] = field(default_factory=list)
    """Commands that do again what failed."""
    warnings: list[str] = field(default_factory=list)
    """Equal ones once."""
    settings: list[tuple[str, str, str]] = field(default_factory=list)
    """(name, value, default) of those that differ."""
    libraries: dict[str, str] = field(default_factory=dict)
    """{library: versions} that finished tasks were made with."""

    @property
    def state(self) -> str:
        """failed, unfinished, warnings, done or empty: what matters most first."""
        if self.refused or self.failures:
            return "failed"
        done, every = (sum(s.get(word, 0) for s in self.stages.values()) for word in ("done", "all"))
        if not done:
            return "empty"
        return "unfinished" if done < every else "warnings" if self.warnings else "done"


def accounts(session: Session, names: Sequence[str]) -> Iterator[Account]:
    """Of every sequence in turn, those that cannot be read too: these say why."""
    spent, failed = _seconds(session), _failed(session, names)
    for name in names:
        try:
            yield _account(session, name, spent.get(name, {}), failed[name], bytes_each(len(names)))
        except UserError as e:
            yield Account(name, refused=str(e))


def _account(
    session: Session, name: str, spent: Mapping[str, float], failed: Sequence[FailedTask], most: int
) -> Account:
    plan = session.plan(name, Selection())
    if texts := rendered_instead(plan):
        plan = session.plan(name, Selection(), texts)
    context, results = plan.context, Results(plan.context, _as_asked(plan))
    changes = changes_of(results)[: most_changes(most)]
    return Account(
        name,
        about=(
            f"{number(context.grid.frames, 'frame')} at {context.capture.frame_rate:g} a second,"
            f" {number(len(context.rig), 'camera')}"
            + (f", held out: {', '.join(context.held_out)}" if context.held_out else "")
        ),
        made_otherwise=made_otherwise(session.archive, plan),
        stages=numbers(plan, frozenset(f.task for f in failed)),
        plan=cards([plan]),
        pictures=pictures_of(results, changes, most),
        measures=_measures(results),
        effects=effects_reasons(plan),
        unseen=not_shown(results, changes),
        seconds=dict(sorted(spent.items(), key=lambda item: -item[1])),
        failures=grouped([_failure(f) for f in failed]),
        retry=[retry_command(session.archive, [name], run) for run in dict.fromkeys(f.run for f in failed)],
        warnings=grouped([f"{t.stage}: {w}" for t, r in plan.book.receipts.items() for w in r.warnings]),
        settings=_differing(session, name),
        libraries=_libraries(plan),
    )


def _as_asked(plan: Plan) -> Book:
    """The receipts of what was made under the plan's settings, of its frames and cameras, by whatever code: pictures of
    another size or moment fit neither each other nor what was filmed."""
    otherwise: set[Task] = set()
    for task, verdict in plan.verdicts.items():
        receipt = plan.book.receipts.get(task)
        if receipt is None or verdict.state is State.FRESH:
            continue
        alike = asked_alike(receipt.parts, own_parts(plan.context, task))
        if not alike or not otherwise.isdisjoint(dependencies(plan.context, task)):
            otherwise.add(task)
    asked = {t: r for t, r in plan.book.receipts.items() if t in plan.verdicts and t not in otherwise}
    return replace(plan.book, receipts=asked)


def _failed(session: Session, names: Sequence[str]) -> defaultdict[str, list[FailedTask]]:
    """{sequence: what failed in it}, by one reading of the logs."""
    found: defaultdict[str, list[FailedTask]] = defaultdict(list)
    for task in still_failed(session, [name for name in names if _readable(session.archive, name)]):
        found[task.task.sequence].append(task)
    return found


def _readable(archive: Archive, name: str) -> bool:
    try:
        archive.sequence(name)
    except UserError:
        return False  # its own account says why
    return True


def _failure(failed: FailedTask) -> str:
    blocked = f" (blocks {failed.blocked} more)" if failed.blocked else ""
    return f"{failed.task.label()}: {failed.error}{blocked}"


def _seconds(session: Session) -> dict[str, Counter[str]]:
    """{sequence: {stage: seconds}} of finished tasks, by the ledger."""
    found: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for row in ledger.read(session.archive, ("sequence", "stage", "seconds")):
        if row["seconds"] is not None:
            found[row["sequence"]][row["stage"]] += row["seconds"]
    return found


def _measures(results: Results) -> Curves:
    found: Curves = {}
    for path in results.context.paths:
        if not results.has(METRICS.format(path=path)):
            continue
        rows = results.table(METRICS, path)
        boxed = any(row["region"] == "box" for row in rows)
        for row in rows:
            if row["value"] is not None and (row["region"] == "box" or not boxed):
                curve = found.setdefault(row["measure"], {}).setdefault(row["camera"], [])
                curve.append((float(row["frame"]), float(row["value"])))
    return found


def _differing(session: Session, name: str) -> list[tuple[str, str, str]]:
    """Settings of a sequence that differ from the packaged default; the archive's place is no setting of a result."""
    configuration = session.configuration
    own = _flat(configuration.for_sequence(name).model_dump(mode="json"))
    usual = _flat(validate(configuration.layers[:1]).default.model_dump(mode="json"))
    return [
        (key, str(own.get(key, "not set")), str(usual.get(key, "not set")))
        for key in {**usual, **own}
        if own.get(key) != usual.get(key) and key != "archive"
    ]


def _flat(values: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in values.items():
        found |= _flat(value, f"{above}{key}.") if isinstance(value, Mapping) and value else {f"{above}{key}": value}
    return found


def _libraries(plan: Plan) -> dict[str, str]:
    """Of every library, the versions that receipts name."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    for receipt in plan.book.receipts.values():
        told = receipt.facts.get("libraries")
        for library, version in told.items() if isinstance(told, Mapping) else ():
            found[str(library)].add(str(version))
    return {library: ", ".join(sorted(versions)) for library, versions in sorted(found.items())}
