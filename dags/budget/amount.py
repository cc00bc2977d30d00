"""How many seconds a run may take, as written: `2s/frame`, `3h`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from posegaussian.dags.budget.points import PRESETS
from posegaussian.storage.model.errors import ConfigError

UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
LONGEST = 366 * 24 * 3600.0
"""Seconds."""
_WRITTEN = re.compile(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*([a-z]+)\s*(/\s*frame)?\s*")


@dataclass(frozen=True)
class Amount:
    """Seconds by the clock."""

    seconds: float
    """Above 0."""
    a_frame: bool
    """Whether each frame may take so long, or all of the run together."""
    text: str
    """As it was written."""

    @classmethod
    def of(cls, text: str) -> Amount:
        """Read `2s/frame`, `500ms/frame`, `90min`, `3h`. Raises ConfigError for anything else."""
        found = _WRITTEN.fullmatch(text)
        if found is None or found[2] not in UNITS:
            raise ConfigError(
                f"--budget {text}: write seconds a frame, or the time of the whole run, with a unit of"
                f" {', '.join(UNITS)} (2s/frame, 500ms/frame, 90min, 3h), or one of {', '.join(PRESETS)}"
            )
        seconds = float(found[1]) * UNITS[found[2]]
        if not 0 < seconds <= LONGEST:
            raise ConfigError(f"--budget {text}: must be above 0 and at most {LONGEST / 3600:g}h")
        return cls(seconds, found[3] is not None, text.strip())

    def over(self, frames: int) -> float:
        """Seconds of a run of so many frames."""
        return self.seconds * frames if self.a_frame else self.seconds

    def __str__(self) -> str:
        return self.text

    def enough(self, seconds: float, frames: int) -> str:
        """An amount, written alike, that a run of so many seconds and frames fits: a twentieth more, for two digits."""
        if not self.a_frame:
            return f"{math.ceil(1.05 * seconds)}s"
        rounded = float(f"{1.05 * seconds / frames:.2g}")
        return f"{f'{rounded:f}'.rstrip('0').rstrip('.')}s/frame"
