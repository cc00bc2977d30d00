"""The best settings that a run can afford, and the cheapest that are good enough, by what they take and reach on this
machine and capture."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from posegaussian.dags.budget.amount import Amount
from posegaussian.dags.budget.decibels import Decibels
from posegaussian.dags.budget.expected import Expected, Trials, given, values_of
from posegaussian.dags.budget.points import POINTS, Point, preset
from posegaussian.dags.humanize.text import number, seconds_text
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.errors import ConfigError


@dataclass(frozen=True)
class Choice:
    """What was chosen, and what was not."""

    asked: str
    """`budget 3s/frame`, `quality 28dB`."""
    chosen: Expected
    cheaper: Expected | None
    better: Expected | None
    frames: int

    def sentences(self) -> list[str]:
        """What is run, what is expected of it, and its neighbours."""
        lines = [f"{self.asked}, {number(self.frames, 'frame')}: {self.chosen.told(self.frames)}"]
        if self.better is not None:
            lines.append(f"next better: {self.better.told(self.frames)}")
        if self.cheaper is not None:
            lines.append(f"next cheaper: {self.cheaper.told(self.frames)}")
        return lines

    def against(self, seconds: float, measured: Sequence[float]) -> list[str]:
        """What was expected beside what a run took, and beside the box PSNR, dB, of the held-out pictures that it
        measured, if there are any."""
        took = f"{seconds_text(seconds)} it took ({seconds / self.frames:.2g} s a frame)"
        lines = [f"{self.asked}: {seconds_text(self.chosen.seconds)} were expected, {took}"]
        if measured:
            reached, promised = sum(measured) / len(measured), self.chosen.promised
            # a smaller picture hides what a larger one would show
            enlarged = " of them once enlarged" if self.chosen.values.get("frames.size") is not None else ""
            expected = "" if promised is None else f", {promised:.2f} dB were expected{enlarged}"
            lines.append(
                f"{self.asked}: held-out cameras reached {reached:.2f} dB in the box, mean of"
                f" {number(len(measured), 'picture')}{expected}"
            )
        return lines


def preset_values(session: Session, names: Sequence[str], name: str) -> dict[str, Any]:
    """{stage.key: value} of a preset for these sequences, nothing measured."""
    return values_of(preset(name), [session.undecided(n, ()) for n in names], given(session.configuration))


def affordable(
    session: Session,
    names: Sequence[str],
    paths: tuple[str, ...],
    amount: Amount,
    selection: Selection,
    points: Sequence[Point] = POINTS,
) -> Choice:
    """The dearest of the points that fits, found by running some on a few frames of the largest sequence: the cheapest,
    then those around the budget. What that takes counts where the time of the whole run is given.

    Raises ConfigError where not even the cheapest one fits, RunFailed where a probe fails.
    """
    begun = time.monotonic()

    def measuring() -> float:
        return 0.0 if amount.a_frame else time.monotonic() - begun

    with Trials(session, names, paths, selection, points) as trials:
        frames = trials.frames
        name = trials.probe.context.sequence.name
        session.say(
            [f"measuring what settings take on a few frames of {name}: the cheapest, then those near the budget"]
        )
        known, fitting = _measured(trials, amount, measuring)
    if not known:
        raise ConfigError(f"--budget {amount}: none of the settings can be run on this capture, see above")
    if not fitting:
        cheapest = known[min(known)]
        # what is made once a sequence is shared by its frames
        fewer = "" if amount.a_frame else " fewer frames by frames.range,"
        raise ConfigError(
            f"--budget {amount}: the cheapest settings already take {cheapest.told(frames)}; give at least"
            f" {amount.enough(cheapest.seconds + measuring(), frames)},{fewer} or fewer views by views.sources"
        )
    chosen = max(fitting)
    cheaper, better = (
        max((n for n in known if n < chosen), default=None),
        min((n for n in known if n > chosen), default=None),
    )
    return Choice(
        f"budget {amount}",
        known[chosen],
        None if cheaper is None else known[cheaper],
        None if better is None else known[better],
        frames,
    )


def _measured(
    trials: Trials, amount: Amount, measuring: Callable[[], float]
) -> tuple[dict[int, Expected], dict[int, Expected]]:
    """Points by number: those that were tried and can be run, and of these those that fit into what `measuring`,
    seconds so far, leaves of the amount.

    Nothing more is tried where that, should it take as long as any did, would leave less than the dearest takes that is
    known to fit. Where it takes longer yet and nothing fits any more, the cheapest that did counts: a run that ends
    late is better than none.
    """
    known: dict[int, Expected] = {}
    fitted: dict[int, Expected] = {}
    tried: dict[int, Expected | None] = {}
    place: int | None = 0
    longest = 0.0
    while place is not None:
        before = measuring()
        tried[place] = found = trials[place]
        longest, left = max(longest, measuring() - before), amount.over(trials.frames) - measuring()
        if found is not None:
            known[place] = found
            fitted |= {place: found} if found.seconds <= left else {}
        if fitted and not amount.a_frame and left - longest < fitted[max(fitted)].seconds:
            break
        place = _next(trials, tried, left)
    fitting = {n: e for n, e in known.items() if e.seconds <= left}
    if fitted and not fitting:
        cheapest = min(fitted)
        fitting = {cheapest: fitted[cheapest]}
        trials.session.say(["measuring took longer than was foreseen: the run will end late"])
    return known, fitting


def _next(trials: Trials, tried: Mapping[int, Expected | None], left: float) -> int | None:
    """The point to try next, so that in the end the dearest that fits into `left` seconds is known, and its neighbours;
    None when they are.

    Between the dearest that fits and the cheapest that does not, the dearest that should fit, as the points' own
    seconds stand to those of what was tried last.
    """
    known = {n: e for n, e in tried.items() if e is not None}
    fits = max((n for n, e in known.items() if e.seconds <= left), default=-1)
    too_dear = min((n for n, e in known.items() if e.seconds > left), default=len(trials))
    between = [n for n in range(fits + 1, too_dear) if n not in tried]
    if between:
        if not known:
            return between[0]
        last = list(known.values())[-1]
        room = (left - last.once) / max(last.seconds - last.once, 1e-9) * last.point.seconds
        return max((n for n in between if trials.points[n][0].seconds <= room), default=between[0])
    below = range(max((n for n in known if n < fits), default=-1) + 1, fits)
    return max((n for n in below if n not in tried), default=None)


def good_enough(
    session: Session,
    names: Sequence[str],
    paths: tuple[str, ...],
    wanted: Decibels,
    selection: Selection,
    points: Sequence[Point] = POINTS,
) -> Choice:
    """The cheapest of the points that draws held-out cameras so well: as measured before where points say what they
    reach and the user set nothing else, else on a few frames of the largest sequence.

    Raises ConfigError where none is so good, UserError where there is nothing to measure by; RunFailed where a probe
    fails.
    """
    own, contexts = given(session.configuration), [session.undecided(n, paths) for n in names]
    known = all(p.reached is not None and values_of(p, contexts, own).keys() == p.knobs for p in points)
    near = _around(points, wanted) if known else points
    short: list[Expected] = []
    chosen = better = None
    with Trials(session, names, paths, selection, near, compared=not known) as trials:
        frames = trials.frames
        name = trials.probe.context.sequence.name
        session.say([f"measuring what settings take on a few frames of {name}, cheapest first"])
        for expected in (e for n in range(len(trials)) if (e := trials[n]) is not None):
            if chosen is not None:
                better = expected
                break
            if expected.reached is None or not wanted.met(expected.reached):
                short.append(expected)
                continue
            chosen = expected
            if not known:  # what is dearer takes longer to measure, too
                break
    if chosen is None and known:
        raise ConfigError(f"--quality {wanted}: none of the settings that reach it can be run, see above")
    if chosen is None:
        raise _too_good(wanted, [e.reached for e in short if e.reached is not None])
    return Choice(f"quality {wanted}", chosen, short[-1] if short else None, better, frames)


def _around(points: Sequence[Point], wanted: Decibels) -> Sequence[Point]:
    """The first of points, cheapest first, that was measured to be so good, the one before it and all behind, which are
    tried as far as one of them can be run. Raises ConfigError."""
    reached = [p.reached for p in points if p.reached is not None]
    first = next((i for i, psnr in enumerate(reached) if wanted.met(psnr)), None)
    if first is None:
        raise _too_good(wanted, reached)
    return points[max(0, first - 1) :]


def _too_good(wanted: Decibels, reached: Sequence[float]) -> ConfigError:
    """That no settings reach what is asked for."""
    if not reached:
        return ConfigError(f"--quality {wanted}: none of the settings can be run on this capture, see above")
    best = max(reached)
    return ConfigError(
        f"--quality {wanted}: the best of the settings reach {best:.2f} dB; ask for at most {Decibels.below(best)}, or"
        " look for better ones with `posegaussian tradeoff --search` and give what it finds by --front"
    )
