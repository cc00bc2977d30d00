"""Which stages a run may touch, and which it makes anew though they are fresh."""

from __future__ import annotations

from dataclasses import dataclass

from posegaussian.stages.registry import STAGES
from posegaussian.storage.model.errors import ConfigError


@dataclass(frozen=True)
class Selection:
    """Which stages a run may touch."""

    only: frozenset[str] = frozenset()
    """Run these stages alone; everything they read must be fresh. Empty: all."""
    start: str | None = None
    """Rerun this stage and every later one, fresh or not."""
    force: frozenset[str] = frozenset()
    """Rerun these stages even where they are fresh."""

    def __post_init__(self) -> None:
        known = [s.name for s in STAGES]
        for name in sorted({*self.only, *self.force, *([self.start] if self.start else [])}):
            if name not in known:
                raise ConfigError(f"no stage {name!r}; the stages are {', '.join(known)}")
        if self.only and (left := self.force - self.only):
            raise ConfigError(
                f"--force {' '.join(sorted(left))} is left out by --only {' '.join(sorted(self.only))}; name it in"
                " both, or in neither"
            )
        if self.only and self.start and not any(self.forced(name) for name in self.only):
            raise ConfigError(
                f"--from {self.start} is left out by --only {' '.join(sorted(self.only))}: no stage is in both"
            )

    def forced(self, stage: str) -> str | None:
        """The option that reruns a stage though it is fresh, or None."""
        names = [s.name for s in STAGES]
        if stage in self.force:
            return f"forced by --force {stage}"
        if self.start is not None and names.index(stage) >= names.index(self.start):
            return f"forced by --from {self.start}"
        return None

    def allows(self, stage: str) -> bool:
        """Whether a stage may run at all."""
        return not self.only or stage in self.only
