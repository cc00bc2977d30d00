"""What every command does first: configuration, archive, sequences; and one run from start to end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

from rich.console import Console

from posegaussian.dags.config.settings import Configuration, RunSettings, load_configuration
from posegaussian.dags.diagnostics import held_out, learned_share, tables
from posegaussian.dags.diagnostics.profile import Spending
from posegaussian.dags.diagnostics.progress import JsonLines, PlainProgress, TerminalProgress, WarningCollector
from posegaussian.dags.diagnostics.remaining_time import Remaining
from posegaussian.dags.diagnostics.run_log import RunLog, retry_command
from posegaussian.dags.diagnostics.run_summary import results_and_next
from posegaussian.dags.diagnostics.status import every_standing
from posegaussian.dags.humanize.text import Voice, number
from posegaussian.dags.planning import forecast
from posegaussian.dags.planning.context import Context, make_context
from posegaussian.dags.planning.plan import Plan, decided, make_plan
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.resources import CPU, fitted, local_pools, refusals
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Product
from posegaussian.dags.provenance.once import one_moment
from posegaussian.dags.runtime import entering, run_registry, threads
from posegaussian.dags.runtime.events import Listener, RunEnded, SequenceRefused
from posegaussian.dags.runtime.eviction import Keeper
from posegaussian.dags.runtime.failures import Kind, failures_table
from posegaussian.dags.runtime.in_flight import Backend, Rules
from posegaussian.dags.runtime.ordering import lacks_description
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.signals import STATUS, interruptible
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.dags.session.choosing import chosen, chosen_one
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.lease import own_name
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.files.write import require_writable, write_atomically
from posegaussian.storage.model.errors import ConfigError, NotWritten, SchedulerLost, UserError


@dataclass(frozen=True)
class RunOutcome:
    """What came of a run."""

    ended: RunEnded
    """Its numbers."""
    collector: WarningCollector
    """Warnings and failures."""
    spending: Spending
    """Where the seconds went."""
    folder: Path
    """Its folder in the archive."""
    refused: tuple[str, ...]
    """`SEQUENCE: sentence` of every sequence that could not be planned or served."""
    unwritten: tuple[str, ...] = ()
    """Sentences about the run's own records, log and ledger, that the disk did not take."""


@dataclass(frozen=True)
class Session:
    """A configuration and the archive it names."""

    configuration: Configuration
    archive_url: str
    console: Console
    machine: bool = False
    """Whether standard output belongs to a machine: events as JSON lines instead of progress."""
    voice: Voice = Voice.NORMAL
    """How much is said."""
    options: tuple[str, ...] = ()
    """The options that led here, as words of a command:
    another command with them sees the same archive and settings."""

    @classmethod
    def open(cls, config: Path | None, assignments: Sequence[str], archive: str | None, console: Console) -> Session:
        """Read the configuration. Raises ConfigError with all its faults."""
        configuration = load_configuration(config, assignments)
        given = (("--archive", archive), ("--config", config), *(("--set", a) for a in assignments))
        options = tuple(word for option, value in given if value is not None for word in (option, str(value)))
        return cls(configuration, archive or configuration.default.archive, console, options=options)

    @property
    def archive(self) -> Archive:
        """The archive; ArchiveError when there is none."""
        return Archive.open(self.archive_url)

    def names(self, globs: Sequence[str]) -> list[str]:
        """Names of the sequences that names and globs choose, as `chosen` says."""
        return chosen(self.archive, globs)

    def one_name(self, glob: str | None) -> str:
        """The one sequence that a name or glob chooses, as `chosen_one` says."""
        return chosen_one(self.archive, glob)

    def context(self, name: str, paths: tuple[str, ...] = ()) -> Context:
        """One sequence under its settings, with what the survey decided of it where that is known."""
        return decided(Book.open(self.undecided(name, paths)))

    def undecided(self, name: str, paths: tuple[str, ...]) -> Context:
        """One sequence under its settings alone."""
        return make_context(self.archive.sequence(name), self.configuration.for_sequence(name), paths)

    def plan(
        self,
        name: str,
        selection: Selection,
        paths: tuple[str, ...] = (),
        held: Callable[[Context], frozenset[Product]] | None = None,
    ) -> Plan:
        """The plan of one sequence; `held` says what must be there afterwards, whatever `keep` says."""
        return make_plan(self.undecided(name, paths), selection, held)

    def fitted(self, plans: Sequence[Plan]) -> tuple[RunSettings, tuple[str, ...]]:
        """The `run` settings with as many workers as the largest task of the plans leaves room for, and a sentence
        where these are fewer than the cores ask for."""
        return fitted(self.configuration.default.run, plans)

    def backend(self, plans: Sequence[Plan] = ()) -> Backend:
        """Where the tasks of plans run, from `run.scheduler`."""
        run = self.fitted(plans)[0]
        threads.limit(run.threads)
        if run.scheduler == "serial":
            from posegaussian.dags.runtime.executors.serial import SerialBackend

            return SerialBackend(local_pools(run)[CPU].ram)
        from posegaussian.dags.runtime.executors.dask import DaskBackend
        from posegaussian.dags.runtime.executors.unavailable import UnreachedBackend

        try:
            return DaskBackend(run, self.archive.root)
        except SchedulerLost as e:
            return UnreachedBackend(local_pools(run), e)

    def refusals(self, plans: Sequence[Plan]) -> list[str]:
        """Sentences about work that no worker of this machine could do, and about a folder that takes no file, or what
        the disk does not hold; of a scheduler given by address nothing is known before it is asked."""
        todo = [p for p in plans if not p.all_fresh]
        run = self.fitted(todo)[0]
        return [
            *(refusals(plans, local_pools(run)) if run.scheduler in ("serial", "local") else []),
            *(self._shut(todo) or (self._disk(todo).refusals() if todo else [])),
        ]

    def _shut(self, plans: Sequence[Plan]) -> list[str]:
        """Sentences about the first folder that takes no file, of those that a run of the plans writes to."""
        try:
            self._require_writable(plans)
        except NotWritten as e:
            return [str(e)]
        return []

    def _require_writable(self, plans: Sequence[Plan]) -> None:
        """Raise NotWritten unless a run of the plans may write where it would."""
        for folder in (self.archive.root, *(p.context.sequence.root for p in plans)) if plans else ():
            require_writable(folder)

    @cached_property
    def history(self) -> forecast.History:
        """What the archive's finished tasks took."""
        return forecast.History.read(self.archive)

    def room(self, plans: Sequence[Plan]) -> forecast.Room:
        """How much of results of other settings may lie aside while plans run."""
        return forecast.room(plans, self.archive, self.history)

    def _disk(self, plans: Sequence[Plan]) -> forecast.Disk:
        return forecast.Disk.of(plans, self.archive, self.history)

    def disk_warnings(self, plans: Sequence[Plan]) -> list[str]:
        """Sentences about results of other settings that a run of the plans deletes for good, and about a disk that
        may not hold what it writes."""
        todo = [p for p in plans if not p.all_fresh]
        kept = self.configuration.default.run.keep_variants
        return [*self.room(todo).sentences(kept), *self._disk(todo).doubts()] if todo else []

    def _rules(self, name: str, kept: int | None = None) -> Rules:
        run = self.configuration.default.run
        return Rules(RunTerms(name, run.lease, run.timeout, kept), run.retries, run.backoff)

    def run(self, plans: Sequence[Plan], selection: Selection, refused: Sequence[str] = ()) -> RunOutcome:
        """Run plans, show progress, keep the effective settings and the log in the archive, and bring the ledger up to
        date.

        A sequence whose work no worker can do is refused before the start; raises ConfigError when none is left, and
        when the disk does not hold what is measured that it writes; NotWritten where nothing may be written.
        """
        self._require_writable(plans)
        too_much = self._disk(plans).refusals()
        if too_much:
            raise ConfigError("\n".join(too_much))
        collector, spending, keeper = WarningCollector(), Spending(), Keeper(plans)
        self.hint(self.fitted(plans)[1])
        backend = self.backend(plans)
        impossible = {p.context.sequence.name: found for p in plans if (found := refusals([p], backend.pools))}
        refused = [*refused, *(f"{name}: {'; '.join(found)}" for name, found in impossible.items())]
        plans = [p for p in plans if p.context.sequence.name not in impossible]
        if not plans:
            backend.close(hard=True)
            raise ConfigError("\n".join(refused))
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
        folder = self.archive.place(f"{ledger.RUNS}/{stamp}")
        paths = next((p.context.path_texts for p in plans if p.context.asked_for), ())
        try:
            write_atomically(folder / "pipeline.yaml", self.configuration.as_yaml(paths).encode())
        except NotWritten:
            backend.close(hard=True)
            raise
        remaining = Remaining.of(plans, self.history, sum(pool.workers for pool in backend.pools.values()))
        log = RunLog(folder)
        listeners: list[Listener] = [remaining, *self._progress(remaining), collector, spending, log, keeper]
        self.hint([remaining.sentence] if remaining.expected else ())
        for sentence in refused:
            name, _, error = sentence.partition(": ")
            for listener in listeners:
                listener(SequenceRefused(name, error))
        for p in plans:
            self.say(
                (
                    f"{p.context.sequence.name}: {other.sentence(time.time())} is at work here, too;"
                    " what it holds is waited for"
                    for other in run_registry.others(p.context.sequence)
                ),
                "yellow",
            )
        run = Run(
            plans,
            selection,
            backend,
            listeners,
            self.configuration.default.run.threads,
            self._rules(stamp, self.room(plans).bytes),
        )
        with interruptible(self.say_line, backend.kill):
            ended = run.go()
        self.say(keeper.sentences)
        unwritten = [*log.sentences, *self._record(folder, collector)]
        self.say(dict.fromkeys(unwritten), "red")
        every_standing(self, [p.context.sequence.name for p in plans])  # so that the next `status` need not work it out
        return RunOutcome(ended, collector, spending, folder, tuple(refused), tuple(unwritten))

    def _record(self, folder: Path, collector: WarningCollector) -> list[str]:
        """Keep the run's warnings and tracebacks, and bring the ledger up to date; a sentence for each that the disk
        does not take."""
        unwritten = []
        for write in (lambda: self._log(folder, collector), lambda: ledger.rebuild(self.archive)):
            try:
                write()
            except NotWritten as e:
                unwritten.append(str(e))
        return unwritten

    def _progress(self, remaining: Remaining) -> list[Listener]:
        """What tells how far a run is, if anything does."""
        if self.machine:
            return [JsonLines()]
        if self.voice is Voice.QUIET:
            return []
        if self.console.is_terminal:
            return [TerminalProgress(self.console, remaining, self.voice, self.options)]
        return [PlainProgress(self.say_line, remaining, self.voice, self.options)]

    def _log(self, folder: Path, collector: WarningCollector) -> None:
        lines = [f"warning: {w}" for w in collector.warnings]
        for f in collector.failures:
            lines += [f"failed: {f.task.sequence} {f.task.label()}: {f.error}", f.details]
        if lines:
            write_atomically(folder / "log.txt", "\n".join(lines).encode())

    @one_moment()
    def usable(
        self, names: Sequence[str], paths: tuple[str, ...], selection: Selection
    ) -> tuple[list[Plan], list[str]]:
        """As `planned`, with a sentence for each other; raises when none can be."""
        self.say([*self.configuration.idle(self.archive.names()), *ledger.faults(self.archive)], "yellow")
        plans, why = self.planned(names, paths, selection)
        errors = [f"{n}: {w}" for n, w in why.items()]
        if not plans:
            raise ConfigError("\n".join(errors))
        return plans, errors

    def planned(
        self, names: Sequence[str], paths: tuple[str, ...], selection: Selection
    ) -> tuple[list[Plan], dict[str, str]]:
        """Plans of the sequences that can be, and why others cannot, by name."""
        plans, why = [], {}
        for name in names:
            try:
                plans.append(self.plan(name, selection, paths))
            except UserError as e:
                why[name] = str(e)
            except Exception as e:  # whatever is wrong with one, the others are planned
                why[name] = f"cannot be planned: {type(e).__name__}: {e}"
        return plans, why

    def run_and_report(
        self,
        plans: Sequence[Plan],
        selection: Selection,
        refused: Sequence[str] = (),
        say_next: bool = False,
        closing: Callable[[float], None] | None = None,
    ) -> int:
        """Run, say what came of it, and return the exit status: 0 all done, 1 some partition failed or a sequence was
        refused, 130 interrupted.

        `say_next`: end with where the results lie and what to type next. `closing`: called before that with the run's
        seconds, where something ran to its end.
        """
        self.hint(held_out.told(p.context for p in plans))
        for p in plans:
            self.detail(
                f"{p.context.sequence.name}: {stage} not needed: {reason}" for stage, reason in p.unneeded.items()
            )
            self.say([f"{p.context.sequence.name}: {note}" for note in p.notes], "yellow")
        if all(p.all_fresh for p in plans):
            for p in plans:
                if lacks_description(p):
                    entering.enter(p, self._rules(own_name("run")).terms).drop()
            self.say([f"{p.context.sequence.name}: all fresh, nothing to do" for p in plans])
            keeper = Keeper(plans)
            keeper.sweep()
            self.say(keeper.sentences)
            self.hint(results_and_next(plans, self.options, selection) if say_next else ())
            return 1 if refused else 0
        self.say(self.disk_warnings(plans), "yellow")
        outcome = self.run(plans, selection, refused)
        ended = outcome.ended
        self.say([f"warning: {w}" for w in tables.grouped(outcome.collector.warning_sentences())], "yellow")
        if not ended.interrupted and not ended.failed:
            self.hint(learned_share.sentences(plans))
        self.detail(outcome.spending.sentences())
        self._report_failures(outcome, selection, {p.context.sequence.name: p.context.views.names for p in plans})
        taken = f" ({ended.taken} of them taken over from earlier runs with these settings)" if ended.taken else ""
        self.say(
            [
                f"{ended.done} done, {ended.fresh} fresh{taken}, {ended.failed} failed, {ended.blocked} blocked"
                + (f", {ended.left_out} left out by --only" if ended.left_out else "")
                + f" in {ended.seconds:.1f} s"
            ]
        )
        if ended.interrupted:
            self.say(["interrupted; what is done is kept, the next run goes on from here"])
            return STATUS
        if closing is not None:
            closing(ended.seconds)
        if say_next and not ended.failed and not ended.blocked:
            self.hint(results_and_next(plans, self.options, selection))
        return 1 if ended.failed or ended.blocked or outcome.refused or outcome.unwritten else 0

    def _report_failures(self, outcome: RunOutcome, selection: Selection, cameras: dict[str, tuple[str, ...]]) -> None:
        """A table of what failed, where, of which class and why; then who works on what was left, and the command
        that retries the rest."""
        failures, refused = outcome.collector.failures, outcome.refused
        if failures or refused:
            self.console.print(failures_table(failures, refused, cameras))
        self.say(tables.grouped(outcome.collector.blocked_sentences(cameras)), "red")
        held = [f for f in failures if f.kind == Kind.HELD.value]
        if held:
            self.say(
                [f"{number(len(held), 'task')} left to another run, which works there now; run again when it has ended"]
            )
        names = dict.fromkeys(
            [f.task.sequence for f in failures if f not in held] + [r.partition(":")[0] for r in refused]
        )
        if names:
            self.say(
                [
                    " ".join(
                        [
                            "retry with:",
                            retry_command(self.archive, names, outcome.folder.name),
                            *(f"--only {s}" for s in sorted(selection.only)),
                        ]
                    )
                ]
            )

    def hint(self, lines: Iterable[str]) -> None:
        """Print sentences unless asked to be quiet."""
        if self.voice >= Voice.NORMAL:
            self.say(lines)

    def detail(self, lines: Iterable[str]) -> None:
        """Print sentences where every reason is asked for."""
        if self.voice >= Voice.VERBOSE:
            self.say(lines)

    def say(self, lines: Iterable[str], style: str | None = None) -> None:
        """Print sentences as they are."""
        for line in lines:
            self.console.print(line, markup=False, style=style, soft_wrap=True)

    def say_line(self, line: str) -> None:
        """Print one sentence as it is."""
        self.say([line])
