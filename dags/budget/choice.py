"""The best settings that a run can afford, by what they take on this machine and capture."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from posegaussian.dags.budget.amount import Amount
from posegaussian.dags.budget.points import POINTS, Point, preset
from posegaussian.dags.budget.probe import Probe, with_values
from posegaussian.dags.config.faults import dotted, faults_of
from posegaussian.dags.config.settings import Configuration
from posegaussian.dags.humanize.text import number, seconds_text
from posegaussian.dags.planning.context import Context, make_context
from posegaussian.dags.planning.forecast import Loads
from posegaussian.dags.planning.plan import READY, make_plan
from posegaussian.dags.planning.resources import CPU, local_pools
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from posegaussian.stages.depth.methods.registry import BY_PICTURES
from posegaussian.stages.depth.params import DepthParams, method_choice
from posegaussian.storage.model.errors import ConfigError

START = 8.0
"""Seconds until the workers of a run have started, and until its page is written."""
SHARED = 0.9
"""What one of several workers does in the time in which one alone does 1."""
EVERYTHING = Selection()


@dataclass(frozen=True)
class Expected:
    """What a run with the settings of a point is expected to take."""

    point: Point
    values: Mapping[str, Any]
    """{stage.key: value} that the point sets: what the user set is left as it is."""
    seconds: float
    """By the clock."""

    def told(self, frames: int) -> str:
        """`preview (half size, ...): 12.0 s, 0.40 s a frame, -5.2 dB against the default on simulated people`."""
        p, kept = self.point, sorted(self.point.knobs - self.values.keys())
        worth = p.worth if not kept else f"its quality with your own {', '.join(kept)} was not measured"
        return f"{p.name} ({p.told}): {seconds_text(self.seconds)}, {self.seconds / frames:.2g} s a frame, {worth}"


@dataclass(frozen=True)
class Choice:
    """What was chosen, and what was not."""

    chosen: Expected
    cheaper: Expected | None
    better: Expected | None
    amount: Amount
    frames: int

    def sentences(self) -> list[str]:
        """What is run, what is expected of it, and its neighbours."""
        lines = [f"budget {self.amount}, {number(self.frames, 'frame')}: {self.chosen.told(self.frames)}"]
        if self.better is not None:
            lines.append(f"next better: {self.better.told(self.frames)}")
        if self.cheaper is not None:
            lines.append(f"next cheaper: {self.cheaper.told(self.frames)}")
        return lines

    def against(self, seconds: float) -> str:
        """What was expected beside what a run took."""
        return (
            f"budget: {seconds_text(self.chosen.seconds)} were expected, {seconds_text(seconds)} it took"
            f" ({seconds / self.frames:.2g} s a frame; {self.amount} were given)"
        )


def preset_values(session: Session, names: Sequence[str], name: str) -> dict[str, Any]:
    """{stage.key: value} of a preset for these sequences, nothing measured."""
    return _values(preset(name), _contexts(session, names, ()), given(session.configuration))


def choose(
    session: Session,
    names: Sequence[str],
    paths: tuple[str, ...],
    amount: Amount,
    selection: Selection,
    points: Sequence[Point] = POINTS,
) -> Choice:
    """The dearest of the points that fits, found from the cheapest up by running each on a few frames of the largest
    sequence. What that takes counts where the time of the whole run is given.

    Raises ConfigError where not even the cheapest one fits, RunFailed where a probe fails.
    """
    begun = time.monotonic()
    contexts = _contexts(session, names, paths)
    frames = sum(c.grid.frames for c in contexts)
    probe = Probe(max(contexts, key=_work), session.configuration.default.run.threads)
    settings = list(distinct(contexts, given(session.configuration), points))
    for point, values in settings:
        _check(point, values, probe.context)
    fitting: list[Expected] = []
    better = None
    session.say([f"measuring what settings take on a few frames of {probe.context.sequence.name}, cheapest first"])
    try:
        for point, values in settings:
            try:
                expected = Expected(point, values, seconds(contexts, values, probe.rates(values), selection))
            except ConfigError as e:
                session.say([f"{point.name} is left out: {e}"])
                continue
            session.hint([expected.told(frames)])
            if expected.seconds > amount.over(frames) - (0 if amount.a_frame else time.monotonic() - begun):
                better = expected
                break
            fitting.append(expected)
    finally:
        probe.clean()
    if not fitting and better is None:
        raise ConfigError(f"--budget {amount}: none of the settings can be run on this capture, see above")
    if not fitting:
        assert better is not None
        enough = 1.05 * better.seconds / frames  # two digits of it are no less than what it takes
        raise ConfigError(
            f"--budget {amount}: the cheapest settings already take {better.told(frames)}; give at least"
            f" {enough:.2g}s/frame, fewer frames by frames.range, or fewer views by views.sources"
        )
    return Choice(fitting[-1], fitting[-2] if len(fitting) > 1 else None, better, amount, frames)


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
        values = _values(point, contexts, own)
        if values not in seen:
            seen.append(values)
            yield point, values


def _values(point: Point, contexts: Sequence[Context], own: Collection[str]) -> dict[str, Any]:
    """{stage.key: value} of a point: what the user set stays, and a depth method is set only where matching has a
    choice, on no capture of a single view or with depth of its own."""
    kept = set(own)
    if any(method_choice(DepthParams(), c.facts)[0] not in BY_PICTURES for c in contexts):
        kept.add("depth.method")
    longest = max(int(c.capture.rig.size.max()) for c in contexts)
    return {knob: value for knob, value in point.values(longest).items() if knob not in kept}


def _contexts(session: Session, names: Sequence[str], paths: tuple[str, ...]) -> list[Context]:
    archive, configuration = session.archive, session.configuration
    return [make_context(archive.sequence(n), configuration.for_sequence(n), paths) for n in names]


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
    selection: Selection = EVERYTHING,
) -> float:
    """By the clock, of a run of all that is not fresh: `rates` are seconds per unit of work by stage, one task at a
    time. Tasks of a whole sequence run alone; the others share the workers."""
    alone, shared, partitions = 0.0, 0.0, 0
    for context in contexts:
        own = make_context(
            context.sequence,
            with_values(context.settings, values),
            context.path_texts if context.asked_for else (),
        )
        loads = Loads(own)
        for verdict in make_plan(own, selection).verdicts.values():
            task = verdict.task
            if verdict.state in READY or task.stage not in rates:
                continue
            took = rates[task.stage] * loads(task).work
            alone, shared = (alone, shared + took) if task.partition is not None else (alone + took, shared)
        partitions += len(own.grid.partitions)
    workers = local_pools(contexts[0].settings.run)[CPU].workers
    rounds = -(-partitions // workers) / partitions
    return START + alone + shared * rounds / (SHARED if min(workers, partitions) > 1 else 1)


def _work(context: Context) -> int:
    width, height = context.rig.size.max(axis=0)
    return int(context.grid.frames * len(context.views.sources) * width * height)
