"""What settings take on this machine and capture: a few frames of one sequence for each worker are run with them, by
the workers that a run would have, beside its results, and left nothing of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.config.settings import Settings, merge
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan, make_plan
from posegaussian.dags.planning.resources import CPU
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.task_cost import load
from posegaussian.dags.planning.variants import settled_variant
from posegaussian.dags.runtime.in_flight import Backend
from posegaussian.dags.session.session import Session
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive.deletion import delete_folder
from posegaussian.storage.archive.lease import own_name

HELD_OUT = ("held_out",)
"""The path of held-out cameras."""
FRAMES = 4
"""Frames that are run for each worker, a partition of its own."""


def with_values(settings: Any, values: Mapping[str, Any]) -> Any:
    """Settings of a sequence with others for some {stage.key: value}."""
    partial: dict[str, Any] = {}
    for knob, value in values.items():
        stage, _, key = knob.partition(".")
        partial.setdefault(stage, {})[key] = value
    return Settings.model_validate(merge(settings.model_dump(), partial))


def middle(context: Context, count: int) -> str:
    """`frames.range` of `count` frames about the middle of those that are worked on, the first of them one that
    refinement rehearses on."""
    frames, group = context.source_frames, context.settings.refinement.group
    first = max(0, len(frames) // 2 - count // 2) // group * group
    chosen = frames[first : first + count]
    stride = int(np.gcd.reduce(np.diff(chosen))) if len(chosen) > 1 else 1
    return f"{chosen[0]}:{chosen[-1] + 1}:{stride}"


@dataclass
class Probe:
    """Runs settings on a few frames of a sequence for each worker.

    As many tasks run at once as will in the run: of two on two cores depth took 1.04 times what it takes alone,
    refinement 1.23.
    """

    context: Context
    """The sequence, as it is set."""
    session: Session
    """Whose workers run it."""
    partitions: int
    """Of all that the run is of: more workers than that have nothing to do."""
    compared: bool = False
    """Whether pictures are drawn of the cameras that are held out, whichever others are asked for."""
    cold: float = 0.0
    """Seconds by the clock that first tasks took longer so far, because they import and load."""
    _warm: set[str] = field(default_factory=set)
    """Stages that ran: a first task of a stage imports libraries and loads kernels, which no later one does."""
    _folders: set[Path] = field(default_factory=set)
    _name: str = field(default_factory=lambda: own_name("probe"))
    """In the names of its folders: `clean` deletes none that another process uses."""

    @cached_property
    def backend(self) -> Backend:
        """The workers, which stay until `clean`."""
        everything = Selection(force=frozenset(s.name for s in STAGES))
        return self.session.backend([make_plan(self.context, everything)])

    def start(self) -> None:
        """Start the workers, or reach them. Raises ConfigError where there are none."""
        _ = self.backend

    @property
    def workers(self) -> int:
        """That there are for work of the CPU."""
        return self.backend.pools[CPU].workers

    @property
    def frames(self) -> int:
        """Frames that are run."""
        return min(FRAMES * max(1, min(self.workers, self.partitions)), len(self.context.source_frames))

    def rates(self, values: Mapping[str, Any]) -> dict[str, float]:
        """{stage: seconds of its tasks per unit of work} under these {stage.key: value}. What an earlier probe made
        and would come out equal is not made again. Raises RunFailed."""
        plan = self._run(self._variant(values), Selection())
        fresh = frozenset({t.stage for t in plan.verdicts} - self._warm - plan.unneeded.keys())
        if fresh:
            cold, self._warm = _seconds(plan), self._warm | fresh
            plan = self._run(plan.context, Selection(force=fresh))
            warm = _seconds(plan)
            self.cold += sum(max(0.0, cold[s] - warm[s]) for s in fresh) / self.workers
        seconds, work = _seconds(plan), Counter[str]()
        for task in plan.book.receipts:
            work[task.stage] += load(plan.context, task).work
        return {s: seconds[s] / work[s] for s in seconds if work[s] and s not in plan.unneeded}

    def reached(self, values: Mapping[str, Any]) -> float:
        """Mean box PSNR, dB, at the size that the user set, of the frames' held-out cameras as drawn under these
        {stage.key: value}, whose `rates` were taken. Raises UserError where none of them has a picture of the subject,
        whatever is set."""
        from posegaussian.dags.diagnostics.held_out_quality import box_psnr, require_subject

        drawn, filmed = self._variant(values), self._variant({k: v for k, v in values.items() if k != "frames.size"})
        names = [s.name for s in STAGES]
        self._run(filmed, Selection(only=frozenset(names[: names.index("frames") + 1])))
        require_subject(filmed)
        return box_psnr(drawn, filmed)

    @property
    def told(self) -> str:
        """What it runs: `walk, 4 frames`."""
        return f"{self.context.sequence.name}, {number(self.frames, 'frame')}"

    def _variant(self, values: Mapping[str, Any]) -> Context:
        different = {**values, "frames.range": middle(self.context, self.frames)}
        settings = with_values(self.context.settings, {**different, "run.keep": "everything"})
        paths = HELD_OUT if self.compared else self.context.path_texts if self.context.asked_for else ()
        sequence = self.context.sequence
        length = min(FRAMES, sequence.partition_frames)
        found = settled_variant(sequence, settings, {"probe": different, "by": self._name}, paths, length)
        self._folders.add(found.sequence.root.parent)
        return found

    def _run(self, context: Context, selection: Selection) -> Plan:
        from posegaussian.dags.runtime.executors.inline_run import run_here

        plan = make_plan(context, selection)
        run = self.session.configuration.default.run
        run_here(plan, selection, run.threads, workers=self.backend, say=self.session.say_line)
        return plan

    def clean(self) -> None:
        """Let the workers go and delete all that was made."""
        if "backend" in self.__dict__:
            self.backend.close()
        for folder in self._folders:
            delete_folder(folder)


def _seconds(plan: Plan) -> Counter[str]:
    """Of all that is there, by stage."""
    seconds = Counter[str]()
    for task, receipt in plan.book.receipts.items():
        seconds[task.stage] += receipt.facts["seconds"]
    return seconds
