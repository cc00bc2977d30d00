"""The back end of a cluster that did not start: the run fails with its sentence, and the next one does what is left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn

from posegaussian.dags.planning.resources import Pool, pool_for
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.runtime.work_order import WorkOrder
from posegaussian.storage.model.errors import SchedulerLost


class UnreachedBackend:
    """`posegaussian.dags.runtime.in_flight.Backend` of workers nobody can reach: asked for room it raises
    SchedulerLost."""

    def __init__(self, pools: Mapping[str, Pool], why: SchedulerLost) -> None:
        """`pools`: what its workers would have served."""
        self.pools, self._why = pools, why
        self.sentences: tuple[str, ...] = ()

    def pool(self, gpu: int) -> str:
        """As if they were there."""
        return pool_for(gpu, self.pools)

    def free(self, pool: str) -> NoReturn:
        """Raises SchedulerLost."""
        raise self._why

    def submit(self, task: Task, order: WorkOrder) -> NoReturn:
        """Raises SchedulerLost."""
        raise self._why

    def next_done(self, seconds: float | None = None) -> NoReturn:
        """Raises SchedulerLost."""
        raise self._why

    def news(self) -> list[str]:
        """None."""
        return []

    def close(self, hard: bool = False) -> None:
        """Nothing to give back."""

    def kill(self) -> None:
        """Nothing outlives this process."""
