"""Which modules the seconds of a stage went to, of stages that say it, as sentences:
of one run, and of all finished tasks."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping

from posegaussian.dags.humanize.text import number, seconds_text
from posegaussian.dags.runtime.events import Event, TaskDone
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.store import Archive

LEAST = 0.01
"""Share below which a module counts among the rest."""


class Spending:
    """Seconds by stage and module over tasks whose kernels took times."""

    def __init__(self) -> None:
        """Nothing spent."""
        self._tasks: Counter[str] = Counter()
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._modules: defaultdict[str, defaultdict[str, float]] = defaultdict(lambda: defaultdict(float))

    @classmethod
    def of(cls, archive: Archive, names: Iterable[str]) -> Spending:
        """Of all finished tasks of some sequences, by the ledger."""
        wanted, found = set(names), cls()
        for row in ledger.read(archive, ("sequence", "stage", "seconds", "modules")):
            if row["sequence"] in wanted:
                found.add(row["stage"], row["seconds"], row["modules"])
        return found

    def __call__(self, event: Event) -> None:
        """Take one event of a run."""
        if isinstance(event, TaskDone):
            facts = event.receipt.facts
            self.add(event.task.stage, facts.get("seconds"), facts.get("modules"))

    def add(self, stage: str, seconds: float | None, modules: Mapping[str, float] | None) -> None:
        """One task; one without times of its modules is left out."""
        if seconds is None or not modules:
            return
        self._tasks[stage] += 1
        self._seconds[stage] += seconds
        for module, own in modules.items():
            self._modules[stage][module] += own

    def sentences(self) -> list[str]:
        """`network took 41.2 s in 3 tasks: refinement 41%, heads 16%, rest 9%`, dearest module first."""
        return [self._sentence(stage) for stage in self._tasks]

    def _sentence(self, stage: str) -> str:
        whole = self._seconds[stage]
        dearest = sorted(self._modules[stage].items(), key=lambda item: -item[1])
        shares = {module: seconds / whole for module, seconds in dearest if seconds >= LEAST * whole}
        shares["rest"] = 1 - sum(shares.values())
        return (
            f"{stage} took {seconds_text(whole)} in {number(self._tasks[stage], 'task')}:"
            f" {', '.join(f'{module} {share:.0%}' for module, share in shares.items())}"
        )
