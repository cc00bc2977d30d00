"""What `run --budget` and `run --quality` ask for, as settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from posegaussian.dags.budget.amount import Amount
from posegaussian.dags.budget.choice import Choice, affordable, good_enough, preset_values
from posegaussian.dags.budget.decibels import Decibels
from posegaussian.dags.budget.expected import given
from posegaussian.dags.budget.front_table import front_points
from posegaussian.dags.budget.points import POINTS, PRESETS, Point, preset
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.errors import ConfigError


@dataclass(frozen=True)
class Bought:
    """Settings, and what was expected of them."""

    words: tuple[str, ...]
    """For `--set`."""
    choice: Choice | None
    """None for a preset, of which nothing is measured."""

    def against(self, seconds: float, plans: Sequence[Plan]) -> list[str]:
        """What was expected beside the seconds that a run of plans took, and beside what it measured."""
        from posegaussian.dags.diagnostics.held_out_quality import as_measured

        return [] if self.choice is None else self.choice.against(seconds, as_measured(plans))


def bought(
    session: Session,
    names: Sequence[str],
    paths: tuple[str, ...],
    selection: Selection,
    budget: str | None = None,
    quality: str | None = None,
    front: Path | None = None,
) -> Bought:
    """The settings for `--budget`, a preset's name or an amount of time, or for `--quality`, decibels; `front` may say
    which settings there are. Says what they are and what others would give.

    Raises ConfigError where not one of the two is given, for a text that is none of these, for a file that is no front,
    where no settings are as cheap or as good, and where nothing can be measured; RunFailed where measuring fails.
    """
    if budget is not None and quality is not None:
        raise ConfigError(f"run: --budget {budget} and --quality {quality}: either chooses the settings; drop one")
    if budget in PRESETS:
        return _preset(session, names, str(budget), front)

    def points() -> Sequence[Point]:
        return POINTS if front is None else front_points(front, [session.undecided(n, paths) for n in names])

    if budget is not None:
        choice = affordable(session, names, paths, Amount.of(budget), selection, points())
    elif quality is not None:
        choice = good_enough(session, names, paths, Decibels.of(quality), selection, points())
    else:
        raise ConfigError(
            f"run: --front {front} is for --budget or --quality; say how many seconds there are, as --budget 3s/frame,"
            " or how good pictures must be, as --quality 28dB"
        )
    session.say(choice.sentences())
    return _told(session, choice.chosen.values, choice)


def _preset(session: Session, names: Sequence[str], name: str, front: Path | None) -> Bought:
    """Settings by name."""
    if front is not None:
        raise ConfigError(f"--budget {name} --front {front}: a front is for an amount of time, such as 3s/frame")
    values = preset_values(session, names, name)
    kept = sorted(preset(name).knobs - values.keys() & given(session.configuration))
    own = f"; {', '.join(kept)} as you set it" if kept else ""
    session.say([f"budget {name}: {preset(name).told}{own}"])
    return _told(session, values, None)


def _told(session: Session, values: Mapping[str, Any], choice: Choice | None) -> Bought:
    """Settings as words, which are said."""
    words = tuple(f"{knob}={'null' if value is None else value}" for knob, value in values.items())
    session.say([f"these settings: {' '.join(f'--set {quote(w)}' for w in words) or 'the ones that are set'}"])
    return Bought(words, choice)
