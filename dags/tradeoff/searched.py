"""The search for the front on the user's own sequence: settings are run on a few of its frames, in variants that share
what is equal and never touch the user's results."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
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
from posegaussian.stages.registry import stage as stage_named
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
"""Frames of the rungs. On a single one refinement seems dearer than it is: it rehearses once for FRAMES of them."""
MEASURE = "psnr box"
LESS = 0.05
"""Share of the seconds by which a setting that is as good must be cheaper: runs of the same differ by as much."""


def run_search(
    session: Session,
    sequence: str | None,
    knobs: Sequence[str],
    texts: Sequence[str],
    runs: int,
    repeats: int,
    output: Path | None,
) -> tuple[list[Level], tuple[str, ...]]:
    """The command: search, time what is left at the end `repeats` times, print the table, write it and its picture.

    Returns the levels of the last rung, cheapest first, and for `--set` what makes of today's settings better ones that
    take no longer, nothing where there are none. Raises UserError without held-out cameras and where today's settings
    cannot be run, ConfigError for knobs and levels that cannot be.
    """
    name = only_sequence(session, sequence)
    origin = with_truth(session, name)
    trials = Trials(session, origin, space(origin, knobs, texts))
    threads.limit(session.configuration.default.run.threads)
    counts = [len(values) for values in trials.levels.values()]
    found = search(counts, trials.own, len(trials.frames), runs, trials)
    last = len(trials.frames) - 1
    levels = [trials.made[setting, last] for setting in found]
    if not levels:
        raise UserError(f"tradeoff: no setting was left for {number(trials.frames[-1], 'frame')} of {name}, see above")
    if repeats > 1:
        trials.clock.measure(levels, repeats)
    levels.sort(key=lambda level: level.total)
    present(session, name, levels, int(trials.reference(last).rig.size.max()), repeats, output)
    line, words = against_own(levels, trials.made.get((trials.own, last)))
    session.say([trials.account(), line])
    return levels, words


def space(context: Context, knobs: Sequence[str], texts: Sequence[str]) -> dict[str, list[Any]]:
    """{knob: levels, cheap to dear}, what is set today among them; knobs of a single level are left out. Raises
    ConfigError for knobs and levels that cannot be."""
    named = {text.partition("=")[0] for text in texts}
    ours = [f"{k}={levels}" for k, levels in SPACE.items() if k not in named and (not knobs or k in knobs)]
    chosen = chosen_levels(context, knobs or list(SPACE), [*texts, *ours])
    for knob, values in chosen.items():
        if (own := _own(context, knob)) not in values:
            values.append(own)
        for value in values:
            level_settings(context, {knob: value})  # a level that cannot be is told before anything runs
        if all(v is None or isinstance(v, int | float) for v in values):
            values.sort(key=lambda v: (v is None, v))
    if not (several := {knob: values for knob, values in chosen.items() if len(values) > 1}):
        raise ConfigError("tradeoff --search: every knob has a single level; give more with --levels KNOB=LEVEL,LEVEL")
    return several


def _own(context: Context, knob: str) -> Any:
    """What a knob is set to."""
    stage, _, key = knob.partition(".")
    return context.settings.model_dump()[stage][key]


class Trials:
    """Runs settings on the frames of a rung, one task at a time in this process."""

    def __init__(self, session: Session, origin: Context, levels: Mapping[str, list[Any]]) -> None:
        """Of one sequence; nothing ran yet."""
        self.session, self.origin, self.levels = session, origin, levels
        self.own: Setting = tuple(values.index(_own(origin, knob)) for knob, values in levels.items())
        """What is set today."""
        # what works on several frames together says nothing on one
        rungs = LADDER if levels.keys() <= SPACE.keys() else LADDER[1:]
        self.frames = sorted({min(n, origin.grid.frames) for n in rungs})
        """Of each rung."""
        self.made: dict[tuple[Setting, int], Level] = {}
        self.asked = Counter[int]()
        """Trials of each rung."""
        self.clock = Clock(session, frames=origin.grid.frames)

    def __call__(self, setting: Setting, rung: int) -> Tried | None:
        """What came of a setting; None, and a sentence, where it cannot be."""
        from posegaussian.dags.diagnostics.held_out_quality import quality

        reference = self.reference(rung)
        self.asked[rung] += 1
        try:
            level = self._run(setting, rung)
        except UserError as e:
            self.session.say([f"{self._label(setting)}: left out: {e}"])
            return None
        level.quality = quality(level.context, reference)
        found = Tried(level.seconds, level.quality[MEASURE])
        told = f"{found.total:.2f} s a frame, {found.quality:.2f} dB"
        self.session.say([f"{number(self.frames[rung], 'frame')}, {self._label(setting)}: {told}"])
        return found

    def reference(self, rung: int) -> Context:
        """Whose pictures truth is taken from: of the setting of today, at the largest size that is searched. Raises
        UserError where that cannot be run, and where nobody is in the pictures."""
        from posegaussian.dags.diagnostics.held_out_quality import require_subject

        setting = self.own
        if "frames.size" in self.levels:
            at = list(self.levels).index("frames.size")
            setting = (*self.own[:at], len(self.levels["frames.size"]) - 1, *self.own[at + 1 :])
        context = self._run(setting, rung).context
        require_subject(context)
        return context

    def account(self) -> str:
        """How many settings were tried on how many frames."""
        every = math.prod(len(values) for values in self.levels.values())
        parts = [f"{self.asked[r]} on {number(f, 'frame')}" for r, f in enumerate(self.frames)]
        return f"of {number(every, 'setting')} {', '.join(parts)} were tried"

    def _run(self, setting: Setting, rung: int) -> Level:
        """Run once; what an earlier one made and would come out equal is taken over, but for what did not run in this
        process yet, and on the last rung for all that was not timed in it: seconds of an earlier run are from other
        circumstances."""
        if (setting, rung) in self.made:
            return self.made[setting, rung]
        values = {knob: levels[i] for (knob, levels), i in zip(self.levels.items(), setting, strict=True)}
        different = {**values, "frames.range": middle(self.origin, self.frames[rung])}
        level = Level(
            values, settled_variant(self.origin.sequence, level_settings(self.origin, different), different, PATH)
        )
        self.clock.run(level)
        last = rung == len(self.frames) - 1
        elsewhere = frozenset(
            s
            for s, identity in level.identities.items()
            if not self.clock.is_warm(level, s)
            or (last and not stage_named(s).sequence_wide and not self.clock.times.get((s, identity)))
        )
        if elsewhere:
            self.clock.run(level, elsewhere)
        level.seconds = self.clock.seconds(level)
        self.made[setting, rung] = level
        return level

    def _label(self, setting: Setting) -> str:
        """What differs from what is set today."""
        changed = [
            f"{knob}={'full' if levels[i] is None else levels[i]}"
            for (knob, levels), i, own in zip(self.levels.items(), setting, self.own, strict=True)
            if i != own
        ]
        return " ".join(changed) or "as it is set"


def against_own(levels: Sequence[Level], own: Level | None) -> tuple[str, tuple[str, ...]]:
    """Where what is set today lies among levels, and for `--set` what is better and takes no longer: of more quality,
    else of as much in clearly less time."""
    if own is None or own not in levels:
        return "what is set today could not be run on so many frames", ()
    line = f"what is set today is line {list(levels).index(own) + 1}"
    good = own.quality[MEASURE]
    others = [
        v
        for v in levels
        if (v.total <= own.total and v.quality[MEASURE] > good)
        or (v.total < (1 - LESS) * own.total and v.quality[MEASURE] == good)
    ]
    if not others:
        return f"{line}; none is better and takes no longer", ()
    best = max(others, key=lambda v: (v.quality[MEASURE], -v.total))
    more, less = best.quality[MEASURE] - good, own.total - best.total
    told = f"has {more:.2f} dB more and takes no longer" if more > 0 else f"is as good and takes {less:.2f} s less"
    words = tuple(f"{k}={'null' if v is None else v}" for k, v in best.values.items() if v != own.values[k])
    return f"{line}; line {list(levels).index(best) + 1} {told}: {' '.join(f'--set {quote(w)}' for w in words)}", words
