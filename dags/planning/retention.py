"""When bytes that can be made again are given up: `keep` of every array, carried out while a run goes.

| keep | the bytes of one partition of an array go |
| --- | --- |
| always | never; `gc` does not offer them either |
| until_done | once every task that reads them is done and fresh; what no task reads is a result and stays |
| never | once no task of the run will read them any more, whether it succeeded or not, and also if none ever did |

The receipt stays with the content digests, so everything made from dropped bytes stays fresh. Default is
`run.keep: everything`: the next thing people do after a run is to export another path, look at a contact sheet or
change a rendering setting, and each of these reads the pictures and Gaussians of every frame; a first-time user with a
short sequence would recompute nearly all of it by surprise. Disk is the smaller trouble there, and `plan` says before
the start what it costs. `run.keep: as_declared` is for the night with a hundred sequences, `keep: {ARRAY: ...}` for
single arrays, and `posegaussian gc` drops afterwards what a run could have dropped.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.dags.planning.tasks import PRODUCERS, Product, Task, inputs
from posegaussian.storage.archive.receipts import Output
from posegaussian.storage.model.spec import ArraySpec, Keep

Part = tuple[str, int | None]
"""An array (path filled in) and a partition: what is dropped together, over all views."""


def policy(settings: Any, spec: ArraySpec, declared: bool = False) -> Keep:
    """How long an array is kept under the settings; `declared`: as if run.keep were as_declared."""
    explicit = settings.keep.get(spec.name)
    if explicit is not None:
        return explicit
    return spec.keep if declared or settings.run.keep == "as_declared" else "always"


def droppable(settings: Any, declared: bool = False) -> dict[str, Keep]:
    """{declared array: until_done or never} of the arrays that may be dropped at all."""
    found = {
        name: policy(settings, spec, declared)
        for name, (stage, spec) in PRODUCERS.items()
        if isinstance(spec, ArraySpec) and not stage.sequence_wide
    }
    return {name: keep for name, keep in found.items() if keep != "always"}


def lost_source(context: Context) -> Path | None:
    """A source file that is not where it was imported from: without it dropped bytes could not be made again."""
    return next((p for f in context.capture.files if not (p := Path(f.path)).is_file()), None)


class Readers:
    """Which tasks of a plan make and read each droppable part."""

    def __init__(self, plan: Plan, keeps: dict[str, Keep]) -> None:
        """Looks at declarations only."""
        self.context, self.keeps = plan.context, keeps
        self.keep: dict[Part, Keep] = {}
        self.makers: dict[Part, list[Task]] = defaultdict(list)
        self.of: dict[Part, list[Task]] = defaultdict(list)
        self.by: dict[Task, list[Part]] = defaultdict(list)
        """Parts a task makes or reads."""
        if not keeps:
            return
        for task in (t for t in plan.verdicts if t.stage not in plan.unneeded):
            for name in [n for n in keeps if PRODUCERS[n][0].name == task.stage]:
                part = (name.format(path=task.path), task.partition)
                self.keep[part] = keeps[name]
                self.makers[part].append(task)
                self.by[task].append(part)
            for i in inputs(plan.context, task):
                for part in {(p.array, p.partition) for p in i.products if i.read.array in keeps}:
                    self.of[part].append(task)
                    self.by[task].append(part)

    def due(self, part: Part, fresh: set[Task], ended: set[Task]) -> bool:
        """Whether a part may go, given the tasks that are fresh and those that ended in any way."""
        readers = self.of.get(part, [])
        if self.keep[part] == "never":
            return all(r in ended for r in readers)
        return bool(readers) and all(r in fresh for r in readers)


def kept_outputs(plan: Plan, maker: Task) -> Iterator[Output]:
    """Outputs of a task that are on disk and that no export asked for."""
    for o in plan.book.receipts[maker].outputs:
        if not o.dropped and Product(o.array, maker.partition, o.view) not in plan.book.held:
            yield o


def settled_outputs(plan: Plan, keeps: dict[str, Keep]) -> Iterator[tuple[Task, Output]]:
    """Outputs on disk that a run with these policies would have dropped: their readers in the plan are all fresh."""
    fresh = {t for t, v in plan.verdicts.items() if v.state is State.FRESH}
    readers = Readers(plan, keeps)
    for part, makers in readers.makers.items():
        if readers.due(part, fresh, fresh):
            for maker in makers:
                if maker in fresh:
                    yield from ((maker, o) for o in kept_outputs(plan, maker) if o.array == part[0])
