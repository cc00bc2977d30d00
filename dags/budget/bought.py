"""What `run --budget` asks for, as settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from posegaussian.dags.budget.amount import Amount
from posegaussian.dags.budget.choice import Choice, choose, preset_values
from posegaussian.dags.budget.front_table import front_points
from posegaussian.dags.budget.points import POINTS, PRESETS, preset
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

    def against(self, seconds: float) -> list[str]:
        """What was expected beside the seconds that a run took."""
        return [] if self.choice is None else [self.choice.against(seconds)]


def bought(
    session: Session,
    names: Sequence[str],
    paths: tuple[str, ...],
    text: str,
    selection: Selection,
    front: Path | None = None,
) -> Bought:
    """The settings for `--budget TEXT`, a preset's name or an amount of time, of which `front` may say the settings
    there are; says what they are and what others would give.

    Raises ConfigError for any other text, for a file that is no front, and where no settings are as cheap; RunFailed
    where measuring fails.
    """
    if text in PRESETS and front is not None:
        raise ConfigError(f"--budget {text} --front {front}: a front is for an amount of time, such as 3s/frame")
    if text in PRESETS:
        values: Mapping[str, Any] = preset_values(session, names, text)
        choice = None
        session.say([f"budget {text}: {preset(text).told}"])
    else:
        points = POINTS if front is None else front_points(front)
        choice = choose(session, names, paths, Amount.of(text), selection, points)
        values = choice.chosen.values
        session.say(choice.sentences())
    words = tuple(f"{knob}={'null' if value is None else value}" for knob, value in values.items())
    session.say([f"these settings: {' '.join(f'--set {quote(w)}' for w in words) or 'the ones that are set'}"])
    return Bought(words, choice)
