"""The search for the front on the user's own sequence: settings are run on a few of its frames, in variants that share
what is equal and never touch the user's results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posegaussian.dags.budget.probe import FRAMES, middle
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.variants import settled_variant
from posegaussian.dags.runtime import threads
from posegaussian.dags.session.session import Session
from posegaussian.dags.tradeoff.pareto import Level
from posegaussian.dags.tradeoff.search import Setting, Tried, search
from posegaussian.dags.tradeoff.tradeoff import (
    PATH,
    Clock,
    chosen_levels,
    level_settings,
    only_sequence,
    present,
    with_truth,
)
from posegaussian.storage.model.errors import ConfigError, UserError

SPACE: Mapping[str, str] = {
    "frames.size": "0.5,0.75,1.0",
    "depth.method": "hull,sgbm,sweep",
    "depth.pairs": "1,2",
    "network.weights": "none,fast,auto",
    "network.iterations": "1,2,4",
    "network.pairs": "1,2",
    "refinement.steps": "0,20,50,200",
    "rendering.sources": "1,2,4",
}
"""{knob: levels, cheap to dear} that are searched where none is named: what pictures follow from, as far as one can
wait for it."""
LADDER = (1, FRAMES, 4 * FRAMES)
"""Frames of the rungs."""
MEASURE = "psnr box"


def run_search(
    session: Session,
    sequence: str | None,
    knobs: Sequence[str],
    texts: Sequence[str],
    runs: int,
    repeats: int,
    output: Path | None,
) -> list[Level]:
    """The command: search, time what is left at the end `repeats` times, print the table, write it and its picture.

    Returns the levels of the last rung, cheapest first. Raises UserError without held-out cameras, ConfigError for
    knobs and levels that cannot be.
    """
    name = only_sequence(session, sequence)
    origin = with_truth(session, name)
    trials = Trials(session, origin, space(origin, knobs, texts))
    threads.limit(session.configuration.default.run.threads)
    counts = [len(values) for values in trials.levels.values()]
    found = search(counts, trials.own, len(trials.frames), runs, trials)
    if not found:
        raise UserError(f"tradeoff: none of the settings could be run on {name}; the sentences above say why")
    last = len(trials.frames) - 1
    levels = [trials.made[setting, last] for setting in found]
    if repeats > 1:
        trials.clock.measure(levels, repeats)
    levels.sort(key=lambda level: level.total)
    size = int(trials.reference(last).rig.size.max())
    present(session, name, levels, size, repeats, output)
    session.say([trials.account(), *_against_own(trials, levels)])
    return levels


def space(context: Context, knobs: Sequence[str], texts: Sequence[str]) -> dict[str, list[Any]]:
    """{knob: levels, cheap to dear}, what is set today among them; knobs of a single level are left out."""
    named = {text.partition("=")[0] for text in texts}
    ours = [f"{k}={levels}" for k, levels in SPACE.items() if k not in named and (not knobs or k in knobs)]
    chosen = chosen_levels(context, knobs or list(SPACE), [*texts, *ours])
    for knob, values in chosen.items():
        own = _own(context, knob)
        if own not in values:
            values.append(own)
    if not (several := {knob: values for knob, values in chosen.items() if len(values) > 1}):
        raise ConfigError("tradeoff --search: every knob has a single level; give more with --levels KNOB=LEVEL,LEVEL")
    return several


def _own(context: Context, knob: str) -> Any:
    """What a knob is set to; a size that is not smaller than the captured pictures is None."""
    stage, _, key = knob.partition(".")
    value = getattr(getattr(context.settings, stage), key)
    value = getattr(value, "value", value)
    return None if knob == "frames.size" and value and value >= int(context.capture.rig.size.max()) else value


class Trials:
    """Runs settings on the frames of a rung, one task at a time in this process."""

    def __init__(self, session: Session, origin: Context, levels: Mapping[str, list[Any]]) -> None:
        """Of one sequence; nothing ran yet."""
        self.session, self.origin, self.levels = session, origin, levels
        self.own: Setting = tuple(values.index(_own(origin, knob)) for knob, values in levels.items())
        """What is set today."""
        self.frames = sorted({min(n, origin.grid.frames) for n in LADDER})
        """Of each rung."""
        self.made: dict[tuple[Setting, int], Level] = {}
        self.clock, self._warm = Clock(session, frames=origin.grid.frames), set[str]()

    def __call__(self, setting: Setting, rung: int) -> Tried | None:
        """What came of a setting; None, and a sentence, where it cannot be."""
        from posegaussian.dags.tradeoff.quality import quality

        try:
            level = self._run(setting, rung)
            level.quality = quality(level.context, self.reference(rung))
        except UserError as e:
            self.session.say([f"{self._label(setting)}: left out: {e}"])
            return None
        found = Tried(level.seconds, level.quality[MEASURE])
        told = f"{found.total:.2f} s a frame, {found.quality:.2f} dB"
        self.session.say([f"{number(self.frames[rung], 'frame')}: {level.label()}: {told}"])
        return found

    def reference(self, rung: int) -> Context:
        """Whose pictures truth is taken from: of the setting of today, at the largest size that is searched."""
        sizes = self.levels.get("frames.size", [None])
        longest = int(self.origin.capture.rig.size.max())
        largest = max(range(len(sizes)), key=lambda i: min(sizes[i] or longest, longest))
        at = list(self.levels).index("frames.size") if "frames.size" in self.levels else None
        setting = self.own if at is None else (*self.own[:at], largest, *self.own[at + 1 :])
        return self._run(setting, rung).context

    def account(self) -> str:
        """How many settings were tried on how many frames."""
        tried = [sum(rung == r for _, rung in self.made) for r in range(len(self.frames))]
        every = 1
        for values in self.levels.values():
            every *= len(values)
        parts = [f"{t} on {number(f, 'frame')}" for t, f in zip(tried, self.frames, strict=True)]
        return f"of {number(every, 'setting')} {', '.join(parts)} were tried"

    def _run(self, setting: Setting, rung: int) -> Level:
        """Run once; what an earlier one made and would come out equal is taken over. A first task of a stage loads
        libraries and kernels, which no later one does: it is run again."""
        if (setting, rung) in self.made:
            return self.made[setting, rung]
        values = {knob: levels[i] for (knob, levels), i in zip(self.levels.items(), setting, strict=True)}
        different = {**values, "frames.range": middle(self.origin, self.frames[rung])}
        settings = level_settings(self.origin, different)
        level = Level(values, settled_variant(self.origin.sequence, settings, different, PATH))
        self.clock.run(level)
        if fresh := frozenset(level.identities.keys() - self._warm):
            self._warm |= fresh
            for stage in fresh:
                self.clock.times.pop((stage, level.identities[stage]), None)
            self.clock.run(level, fresh)
        level.seconds = self.clock.seconds(level)
        self.made[setting, rung] = level
        return level

    def _label(self, setting: Setting) -> str:
        return " ".join(f"{k}={v[i]}" for (k, v), i in zip(self.levels.items(), setting, strict=True))


def _against_own(trials: Trials, levels: Sequence[Level]) -> list[str]:
    """Where what is set today lies, and what is better and takes no longer."""
    own = trials.made[trials.own, len(trials.frames) - 1]
    if own not in levels:
        return []
    better = [v for v in levels if v.total <= own.total and v.quality[MEASURE] > own.quality[MEASURE]]
    line = f"what is set today is line {list(levels).index(own) + 1}"
    if not better:
        return [f"{line}, on the front"]
    best = max(better, key=lambda v: v.quality[MEASURE])
    gain = best.quality[MEASURE] - own.quality[MEASURE]
    words = " ".join(f"--set {k}={v}" for k, v in best.values.items() if v != own.values[k] and v is not None)
    return [f"{line}; line {list(levels).index(best) + 1} takes no longer and has {gain:.2f} dB more: {words}"]
