"""What each decision about an effect costs, in dB and in seconds: the effect is turned against its decision, all else
stays as it was decided, and held-out cameras say what that is worth.

The sequence is run in variants beside it, as a trade-off is; what two of them have in common is made once. Pictures are
compared in the box of the mask after each channel's light was fitted by one gain, as the judge compares them: an effect
that makes cameras agree is not charged for the held-out camera's own exposure. Seconds are those of processors: what
else a machine does meanwhile does not count.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import make_plan
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.variants import settled_variant
from posegaussian.dags.regret.switches import Switch, decided, pinned, switches
from posegaussian.dags.runtime import threads
from posegaussian.dags.runtime.executors.inline_run import run_here
from posegaussian.dags.session.session import Session
from posegaussian.dags.tradeoff.pareto import Level
from posegaussian.dags.tradeoff.tradeoff import PATH, Clock, level_settings
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import UserError

MEASURE = "box PSNR, light fitted"
"""Name of `Level.quality` here, dB."""
CLEAR = 0.005
"""dB below which two settings draw alike: what the table's digits show."""
DECIDING = ("survey", "judge")
"""Stages that are run once a sequence so that something can be decided."""


@dataclass(frozen=True)
class Turned:
    """One effect, or several, turned against what was decided."""

    names: tuple[str, ...]
    gain: float
    """dB that is gained by it: what the decision costs, where it is above 0."""
    seconds: float
    """CPU seconds a frame that it takes more; below 0: fewer."""


@dataclass(frozen=True)
class Regret:
    """What the decisions of one sequence cost."""

    turned: tuple[Turned, ...]
    """Single effects in the order of flow, then pairs, then all together that gain by themselves."""
    everything: Turned
    """All effects on that can be."""
    switches: tuple[Switch, ...]
    """The effects that were turned."""
    ruled_out: Mapping[str, str]
    """{effect: why it can only be what it is}."""
    psnr: float
    """As decided, dB."""
    seconds: float
    """As decided, CPU seconds a frame."""
    deciding: float
    """CPU seconds of survey and judge, once for the sequence."""

    @property
    def best(self) -> Turned:
        """What of all that was tried draws best; nothing turned where that is what was decided."""
        return max((Turned((), 0.0, 0.0), *self.turned, self.everything), key=lambda t: t.gain)

    @property
    def singles(self) -> dict[str, Turned]:
        """By effect."""
        return {t.names[0]: t for t in self.turned if len(t.names) == 1}


def box_psnr(context: Context, reference: Context) -> float:
    """Mean over the held-out pictures, dB; contexts as of `quality`
    (`posegaussian/dags/diagnostics/held_out_quality.py`), whose held-out cameras see somebody."""
    from posegaussian.dags.diagnostics.held_out_quality import compared
    from posegaussian.stages.judge.drawing import score

    frames = (context.grid.bounds(p) for p in context.grid.partitions)
    pictures = itertools.chain.from_iterable(compared(context, reference, f) for f in frames)
    return float(np.mean([score(p.picture, p.mask, p.filmed, p.mask, p.visible)[0] for p in pictures]))


def measured(session: Session, name: str, pairs: bool, repeats: int) -> Regret:
    """Run the sequence as decided and with its effects turned. `repeats`: times every stage that differs is timed.

    Raises UserError without held-out cameras, where nobody is in what they filmed, and where a task fails.
    """
    from posegaussian.dags.diagnostics.held_out_quality import require_subject

    own = Context(session.archive.sequence(name), session.configuration.for_sequence(name), ())
    if not own.held_out:
        raise UserError(
            f"effects --regret: sequence {name} has no camera that pictures could be compared with; keep some aside,"
            f" best ones between two others: --set 'views.held_out=[{own.capture.rig.names[-1]}]'"
        )
    threads.limit(session.configuration.default.run.threads)
    origin, clock = session.context(name, PATH), Clock(session, "cpu_seconds")
    context, deciding = _as_decided(origin, session)
    require_subject(context)
    found, ruled_out = switches(context)
    fixed = pinned(context)
    base = _level(origin, fixed)
    clock.run(base)
    session.say([f"turning {number(len(found), 'effect')}, one at a time"])
    singles, refused = _singles(clock, origin, fixed, found)
    both = itertools.combinations(singles, 2) if pairs else ()
    trials: dict[tuple[Switch, ...], Level] = {(s,): level for s, level in singles.items()}
    trials |= {two: _level(origin, fixed, *two) for two in both}
    everything = _level(origin, fixed, *(s for s in singles if s.decided == "off"))
    _measure(clock, base, [*trials.values(), everything], repeats)
    gaining = tuple(s for s, level in singles.items() if _gain(level, base) >= CLEAR)
    if len(gaining) > 1 and gaining not in trials:
        trials[gaining] = _level(origin, fixed, *gaining)
        _measure(clock, base, [trials[gaining]], repeats)
    return Regret(
        tuple(_turned(tuple(s.name for s in several), level, base) for several, level in trials.items()),
        _turned(("everything on",), everything, base),
        tuple(singles),
        {**ruled_out, **refused},
        base.quality[MEASURE],
        base.total,
        deciding,
    )


def _measure(clock: Clock, base: Level, levels: Sequence[Level], repeats: int) -> None:
    """Fill in seconds and quality, those of the base, too, and keep what was timed for later plans."""
    clock.measure([base, *levels], repeats)
    for level in (base, *levels):
        level.quality = {MEASURE: box_psnr(level.context, base.context)}
        ledger.rebuild(Archive(level.context.sequence.root.parent))


def _as_decided(origin: Context, session: Session) -> tuple[Context, float]:
    """The sequence's context in a variant in which all is decided and run; the seconds that deciding took."""
    session.say(["deciding, as a run does"])
    plan = make_plan(_level(origin, {}).context)
    run_here(plan, Selection(), session.configuration.default.run.threads, say=session.say_line)
    after = make_plan(_level(origin, {}).context)
    receipts = after.book.receipts
    return decided(after.context), sum(
        r.facts.get("cpu_seconds", 0.0) for task, r in receipts.items() if task.stage in DECIDING
    )


def _singles(
    clock: Clock, origin: Context, fixed: Mapping[str, Any], found: Sequence[Switch]
) -> tuple[dict[Switch, Level], dict[str, str]]:
    """Each effect turned and run; and {effect: why} of those without whose decision a stage cannot do, by the word of
    its first failed task."""
    levels, refused = {}, {}
    for switch in found:
        level = _level(origin, fixed, switch)
        try:
            clock.run(level)
            levels[switch] = level
        except UserError as e:
            task = str(e.__cause__).partition("; ")[0]
            refused[switch.name] = task.partition(": ")[2] or task
    return levels, refused


def _level(origin: Context, fixed: Mapping[str, Any], *turned: Switch) -> Level:
    """A variant with these settings and some effects turned; as set where nothing is fixed."""
    values = {**fixed, **{f"effects.{s.name}": s.other for s in turned}}
    settings = level_settings(origin, values)
    return Level(
        {f"effects.{s.name}": s.other for s in turned} or {"effects": "as decided"},
        settled_variant(origin.sequence, settings, {"regret": values}, PATH),
    )


def _gain(level: Level, base: Level) -> float:
    return level.quality[MEASURE] - base.quality[MEASURE]


def _turned(names: tuple[str, ...], level: Level, base: Level) -> Turned:
    return Turned(names, _gain(level, base), level.total - base.total)


def rows(found: Regret) -> list[dict[str, Any]]:
    """One row a single effect, pair, and what was tried together."""
    by_name = {s.name: s for s in found.switches}
    out = []
    for turned in (*found.turned, found.everything):
        single = by_name.get(turned.names[0]) if len(turned.names) == 1 else None
        out.append(
            {
                "effect": " + ".join(turned.names),
                "decided": single.decided if single else "",
                "measured": single.measured if single else "",
                "the other way dB": turned.gain,
                "the other way CPU s/frame": turned.seconds,
                "costs dB": max(0.0, turned.gain),
            }
        )
    return out


def as_lines(found: Regret) -> list[str]:
    """The table and what it comes to, as text."""
    heads = ["effect", "decided", "the other way, dB", "CPU s a frame", "measured, bound"]
    cells = [
        [
            r["effect"],
            r["decided"],
            f"{r['the other way dB']:+.2f}",
            f"{r['the other way CPU s/frame']:+.2f}",
            r["measured"],
        ]
        for r in rows(found)
    ]
    widths = [max(len(line[i]) for line in [heads, *cells]) for i in range(len(heads))]
    table = [
        "  ".join(t.rjust(w) if 1 < i < 4 else t.ljust(w) for i, (t, w) in enumerate(zip(line, widths, strict=True)))
        for line in [heads, *cells]
    ]
    best, all_on = found.best, found.everything
    left = (
        f"best of what was tried: {' + '.join(best.names)} turned, "
        if best.gain >= CLEAR
        else "nothing tried is better, "
    )
    return [
        *(line.rstrip() for line in table),
        f"as decided: {found.psnr:.2f} dB, {found.seconds:.2f} CPU s a frame; deciding took {found.deciding:.1f}, once",
        f"{left}regret {max(0.0, best.gain):.2f} dB",
        f"with everything on: {all_on.gain:+.2f} dB, {all_on.seconds:+.2f} CPU s a frame",
        *(f"not turned: {name}: {why}" for name, why in found.ruled_out.items()),
    ]
