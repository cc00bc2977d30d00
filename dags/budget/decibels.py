"""How near held-out cameras' pictures must be drawn, as written: `28dB`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from posegaussian.storage.model.errors import ConfigError

HIGHEST = 100.0
"""dB: beyond what pictures of 8 bits can tell."""
_WRITTEN = re.compile(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*dB\s*", re.IGNORECASE)


@dataclass(frozen=True)
class Decibels:
    """Mean box PSNR of held-out cameras."""

    psnr: float
    """dB, above 0."""

    @classmethod
    def of(cls, text: str) -> Decibels:
        """Read `28dB`, `27.5 dB`. Raises ConfigError for anything else."""
        found = _WRITTEN.fullmatch(text)
        if found is None:
            raise ConfigError(f"--quality {text}: write the box PSNR of held-out cameras with its unit, such as 28dB")
        psnr = float(found[1])
        if not 0 < psnr <= HIGHEST:
            raise ConfigError(f"--quality {text}: must be above 0 and at most {HIGHEST:g}dB")
        return cls(psnr)

    @classmethod
    def below(cls, psnr: float) -> Decibels:
        """The most of a tenth of a dB that is not above it."""
        return cls(math.floor(psnr * 10) / 10)

    def met(self, psnr: float) -> bool:
        """Whether it is reached, at the two digits that are shown."""
        return round(psnr, 2) >= round(self.psnr, 2)

    def __str__(self) -> str:
        return f"{self.psnr:g}dB"
