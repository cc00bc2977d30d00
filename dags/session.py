"""What every command does first: configuration, archive, sequences; and one run from start to end."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from dags import tables, threads
from dags.config import Configuration, load_configuration
from dags.context import Context, make_context
from dags.events import RunEnded
from dags.plan import Plan, Selection, make_plan
from dags.progress import PlainProgress, TerminalProgress, WarningCollector
from dags.run import Backend, Run
from storage.archive import Archive, write_atomically
from storage.errors import ArchiveError, ConfigError, UserError


@dataclass(frozen=True)
class Session:
    """A configuration and the archive it names."""

    configuration: Configuration
    archive_url: str
    console: Console

    @classmethod
    def open(cls, config: Path | None, assignments: Sequence[str], archive: str | None, console: Console) -> Session:
        """Read the configuration. Raises ConfigError with all its faults."""
        configuration = load_configuration(config, assignments)
        return cls(configuration, archive or configuration.default.archive, console)

    @property
    def archive(self) -> Archive:
        """The archive; ArchiveError when there is none."""
        return Archive.open(self.archive_url)

    def names(self, globs: Sequence[str]) -> list[str]:
        """Names of the sequences that any glob matches; all without globs. Raises ArchiveError when a glob matches none."""
        known = self.archive.names()
        if not known:
            raise ArchiveError(f"archive {self.archive.root} has no sequence yet; `posegaussian import LAYOUT FOLDER` registers one")
        for g in globs:
            if not fnmatch.filter(known, g):
                raise ArchiveError(f"no sequence matches {g!r}; archive {self.archive.root} has {', '.join(known)}")
        return [n for n in known if not globs or any(fnmatch.fnmatchcase(n, g) for g in globs)]

    def one_name(self, glob: str) -> str:
        """The one sequence that a glob matches. Raises ArchiveError for none and for several."""
        matches = self.names([glob])
        if len(matches) > 1:
            raise ArchiveError(f"{glob!r} matches {len(matches)} sequences, {', '.join(matches)}; name one")
        return matches[0]

    def context(self, name: str, paths: tuple[str, ...] = ()) -> Context:
        """One sequence under its settings."""
        return make_context(self.archive.sequence(name), self.configuration.for_sequence(name), paths)

    def plan(self, name: str, selection: Selection, paths: tuple[str, ...] = ()) -> Plan:
        """The plan of one sequence."""
        return make_plan(self.context(name, paths), selection)

    def backend(self) -> Backend:
        """Where tasks run, from `run.scheduler`."""
        run = self.configuration.default.run
        threads.limit(run.threads)
        if run.scheduler == "serial":
            from dags.serial import SerialBackend

            return SerialBackend()
        from dags.cluster import DaskBackend

        return DaskBackend(None if run.scheduler == "local" else run.scheduler, run.workers, run.threads, run.window)

    def run(self, plans: Sequence[Plan], selection: Selection) -> tuple[RunEnded, WarningCollector]:
        """Run plans, show progress, keep the effective settings and the log in the archive, and bring the ledger up to date."""
        collector = WarningCollector()
        progress = TerminalProgress(self.console) if self.console.is_terminal else PlainProgress(lambda line: self.say([line]))
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
        folder = self.archive.root / "_runs" / stamp
        write_atomically(folder / "pipeline.yaml", self.configuration.as_yaml().encode())
        ended = Run(plans, selection, self.backend(), [progress, collector], self.configuration.default.run.threads).go()
        self._log(folder, collector)
        from storage.ledger import rebuild

        rebuild(self.archive)
        return ended, collector

    def _log(self, folder: Path, collector: WarningCollector) -> None:
        """Keep warnings and tracebacks with the run."""
        lines = [f"warning: {w}" for w in collector.warnings]
        for f in collector.failures:
            lines += [f"failed: {f.task.sequence} {f.task.label()}: {f.error}", f.details]
        if lines:
            write_atomically(folder / "log.txt", "\n".join(lines).encode())

    def usable(self, names: Sequence[str], paths: tuple[str, ...], selection: Selection) -> tuple[list[Plan], list[str]]:
        """Plans of the sequences that can be planned, and a sentence for each that cannot; raises when none can."""
        plans, errors = [], []
        for name in names:
            try:
                plans.append(self.plan(name, selection, paths))
            except UserError as e:
                errors.append(f"{name}: {e}")
        if not plans:
            raise ConfigError("\n".join(errors))
        return plans, errors

    def run_and_report(self, plans: Sequence[Plan], selection: Selection) -> int:
        """Run, say what came of it, and return the exit status: 0 all done, 1 some partition failed, 130 interrupted."""
        for p in plans:
            self.say([f"{p.context.sequence.name}: {stage} not needed: {reason}" for stage, reason in p.unneeded.items()])
            self.say(p.notes, "yellow")
        if all(p.all_fresh for p in plans):
            self.say([f"{p.context.sequence.name}: all fresh, nothing to do" for p in plans])
            return 0
        ended, collector = self.run(plans, selection)
        self.say([f"warning: {w}" for w in tables.grouped(collector.warnings)], "yellow")
        self.say([f"failed: {f.task.sequence} {f.task.label()}: {f.error}" for f in collector.failures], "red")
        self.say(tables.grouped(collector.blocked), "red")
        self.say([f"{ended.done} done, {ended.fresh} fresh, {ended.failed} failed, {ended.blocked} blocked" + (f", {ended.left_out} left out by --only" if ended.left_out else "") + f" in {ended.seconds:.1f} s"])
        if ended.interrupted:
            self.say(["interrupted; what is done is kept, the next run goes on from here"])
            return 130
        return 1 if ended.failed or ended.blocked else 0

    def say(self, lines: Iterable[str], style: str | None = None) -> None:
        """Print sentences as they are."""
        for line in lines:
            self.console.print(line, markup=False, style=style, soft_wrap=True)
