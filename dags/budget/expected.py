"""What a run is expected to take with settings: each is tried on a few frames of the largest sequence."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from posegaussian.dags.budget.clock import Tasks, clock
from posegaussian.dags.budget.points import POINTS, Point
from posegaussian.dags.budget.probe import Probe, with_values
from posegaussian.dags.config.faults import dotted, faults_of
from posegaussian.dags.config.settings import Configuration
from posegaussian.dags.humanize.text import seconds_text
from posegaussian.dags.planning.context import Context, make_context
from posegaussian.dags.planning.forecast import Loads
from posegaussian.dags.planning.plan import READY, make_plan
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from posegaussian.stages.depth.methods.registry import BY_PICTURES
from posegaussian.stages.depth.params import DepthParams, method_choice
from posegaussian.storage.model.errors import ConfigError

START = 8.0
"""Seconds until the workers of a run have started, between its tasks, and until its page is written: 7.1 to 8.2 in four
runs of sixteen frames."""
EVERYTHING = Selection()


@dataclass(frozen=True)
class Expected:
    """What a run with the settings of a point is expected to take."""

    point: Point
    values: Mapping[str, Any]
    """{stage.key: value} that the point sets: what the user set is left as it is."""
    seconds: float
    """By the clock."""
    once: float = 0.0
    """Of these, what does not grow with the frames."""
    reached: float | None = None
    """Mean box PSNR of held-out cameras, dB, where it was measured: on this capture, or by who made the point."""
    compared: str | None = None
    """What it was measured on, with all settings as they will be; None: on nothing of this capture."""

    def told(self, frames: int) -> str:
        """`preview (half size, ...): 12.0 s, 0.40 s a frame, -5.2 dB against the default on simulated people`."""
        p = self.point
        return f"{p.name} ({p.told}): {seconds_text(self.seconds)}, {self.seconds / frames:.2g} s a frame, {self.worth}"

    @property
    def promised(self) -> float | None:
        """`reached`, where it was with all settings as they will be."""
        alike = self.compared is not None or self.values.keys() == self.point.knobs
        return self.reached if alike else None

    @property
    def worth(self) -> str:
        """Its quality, in words."""
        if self.compared is not None:
            return f"{self.reached:.2f} dB on held-out cameras of {self.compared}"
        if kept := sorted(self.point.knobs - self.values.keys()):
            return f"its quality with your own {', '.join(kept)} was not measured"
        return self.point.worth


class Trials:
    """Points as they are expected to do on some sequences, numbered from the cheapest on, each tried when it is asked
    for, once; what is made for it is deleted at the end."""

    def __init__(
        self,
        session: Session,
        names: Sequence[str],
        paths: tuple[str, ...],
        selection: Selection,
        points: Sequence[Point],
        compared: bool = False,
    ) -> None:
        """`compared`: whether pictures of held-out cameras are measured, too. Raises ConfigError for settings that
        there are none of, and where such pictures are asked for and there are none."""
        self.session, self.selection, self.compared = session, selection, compared
        self.contexts = [session.undecided(n, paths) for n in names]
        self.frames = sum(c.grid.frames for c in self.contexts)
        """Of all sequences."""
        chosen = [c for c in self.contexts if c.held_out] if compared else self.contexts
        if not chosen:
            raise ConfigError(
                f"--quality: no camera of {', '.join(names)} is held out to measure by; keep some aside, for example"
                f" --set 'views.held_out=[{self.contexts[0].capture.rig.names[-1]}]', or give a"
                " --front that was measured with these settings"
            )
        largest = max(chosen, key=_work)
        self.probe = Probe(largest, session, sum(len(c.grid.partitions) for c in self.contexts), compared)
        self.points = list(distinct(self.contexts, given(session.configuration), points))
        for point, values in self.points:
            _check(point, values, largest)
        self._tried: dict[int, Expected | None] = {}

    def __enter__(self) -> Trials:
        """Raises ConfigError where there are no workers."""
        self.probe.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.probe.clean()

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, n: int) -> Expected | None:
        """What is expected of point n; None of one that cannot be run here, of which the reason is said. Raises
        IndexError, and RunFailed where a probe fails."""
        if n not in self._tried:
            self._tried[n] = self._measured(*self.points[n])
        return self._tried[n]

    def _measured(self, point: Point, values: Mapping[str, Any]) -> Expected | None:
        try:
            rates = self.probe.rates(values)
            took, once = seconds(self.contexts, values, rates, self.probe.workers, self.selection)
            reached = self.probe.reached(values) if self.compared else point.reached
        except ConfigError as e:
            self.session.say([f"{point.name} is left out: {e}"])
            return None
        cold, told = self.probe.cold, self.probe.told if self.compared else None
        expected = Expected(point, values, cold + took, cold + once, reached, told)
        self.session.hint([expected.told(self.frames)])
        return expected


def _check(point: Point, values: Mapping[str, Any], context: Context) -> None:
    """Raise ConfigError for settings that there are none of, as a table of another version may have."""
    try:
        with_values(context.settings, values)
    except ValidationError as e:
        faults = faults_of(e, context.settings.model_dump(), lambda at: "unknown key")
        raise ConfigError(f"{point.name}: " + "; ".join(f"{dotted(at)}: {what}" for at, what in faults)) from e


def distinct(
    contexts: Sequence[Context], own: Collection[str], points: Sequence[Point] = POINTS
) -> Iterator[tuple[Point, dict[str, Any]]]:
    """The points with what each sets, cheapest first, without those that set what an earlier one does; `own`
    {stage.key} the user set."""
    seen: list[dict[str, Any]] = []
    for point in points:
        values = values_of(point, contexts, own)
        if values not in seen:
            seen.append(values)
            yield point, values


def values_of(point: Point, contexts: Sequence[Context], own: Collection[str]) -> dict[str, Any]:
    """{stage.key: value} of a point: what the user set stays, with steps of refinement what they are worth, too, and a
    depth method is set only where matching has a choice, on no capture of a single view or with depth of its own."""
    kept = {*own, *(("refinement.worth",) if "refinement.steps" in own else ())}
    if any(method_choice(DepthParams(), c.facts)[0] not in BY_PICTURES for c in contexts):
        kept.add("depth.method")
    longest = max(int(c.capture.rig.size.max()) for c in contexts)
    return {knob: value for knob, value in point.values(longest).items() if knob not in kept}


def given(configuration: Configuration) -> set[str]:
    """`stage.key` of everything that the user set, for all sequences or some."""
    found = set()
    for layer in configuration.layers[1:]:
        for section in (layer.values, *(layer.values.get("sequences") or {}).values()):
            found |= {f"{s}.{k}" for s, own in section.items() if isinstance(own, Mapping) for k in own}
    return found


def seconds(
    contexts: Sequence[Context],
    values: Mapping[str, Any],
    rates: Mapping[str, float],
    workers: int,
    selection: Selection = EVERYTHING,
) -> tuple[float, float]:
    """By the clock, of a run of all that is not fresh, and of these what is done once however many frames there
    are: `rates` are seconds per unit of work by stage."""
    found = []
    for context in contexts:
        own = make_context(
            context.sequence,
            with_values(context.settings, values),
            context.path_texts if context.asked_for else (),
        )
        plan, tasks = make_plan(own, selection), Tasks()
        loads = Loads(plan.context)  # what the survey decided may give other camera paths
        for verdict in plan.verdicts.values():
            task = verdict.task
            if verdict.state in READY or task.stage not in rates:
                continue
            tasks.add(task, rates[task.stage] * loads(task).work)
        found.append(tasks)
    return START + clock(found, workers), START + clock([replace(t, partitions={}) for t in found], workers)


def _work(context: Context) -> int:
    width, height = context.rig.size.max(axis=0)
    return int(context.grid.frames * len(context.views.sources) * width * height)
