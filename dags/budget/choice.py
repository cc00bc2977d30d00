"""The best settings that a run can afford, and the cheapest that are good enough, by what they take and reach on this
machine and capture."""

from __future__ import annotations

import time
from collections.abc import Sequence
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

    def against(self, seconds: float) -> str:
        """What was expected beside what a run took."""
        return (
            f"{self.asked}: {seconds_text(self.chosen.seconds)} were expected, {seconds_text(seconds)} it took"
            f" ({seconds / self.frames:.2g} s a frame)"
        )


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
    """The dearest of the points that fits, found from the cheapest up by running each on a few frames of the largest
    sequence. What that takes counts where the time of the whole run is given.

    Raises ConfigError where not even the cheapest one fits, RunFailed where a probe fails.
    """
    begun = time.monotonic()
    fitting: list[Expected] = []
    better = None
    with Trials(session, names, paths, selection, points) as trials:
        frames = trials.frames
        for expected in trials:
            if expected.seconds > amount.over(frames) - (0 if amount.a_frame else time.monotonic() - begun):
                better = expected
                break
            fitting.append(expected)
    if not fitting and better is None:
        raise ConfigError(f"--budget {amount}: none of the settings can be run on this capture, see above")
    if not fitting:
        assert better is not None
        measuring = 0 if amount.a_frame else time.monotonic() - begun
        raise ConfigError(
            f"--budget {amount}: the cheapest settings already take {better.told(frames)}; give at least"
            f" {amount.enough(better.seconds + measuring, frames)}, fewer frames by frames.range, or fewer views by"
            " views.sources"
        )
    return Choice(f"budget {amount}", fitting[-1], fitting[-2] if len(fitting) > 1 else None, better, frames)


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
        for expected in trials:
            if chosen is not None:
                better = expected
                break
            if expected.reached is None or expected.reached < wanted.psnr:
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
    first = next((i for i, psnr in enumerate(reached) if psnr >= wanted.psnr), None)
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
