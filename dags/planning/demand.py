"""What is made for readers alone, and whether anybody reads it: no stage runs without a reader.

An output that is kept `until_done` serves its readers; every other one is a result. A stage that makes no result and
whose outputs no stage reads is not needed, and an effect that only such a stage has, or that only draws such an output,
is off. Whoever names the stage (`--only`, `--force`) or the array (`keep: {ARRAY: always}`, an export) still gets it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from posegaussian.stages.contract.declaration import Stage
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.registry import STAGES
from posegaussian.storage.model.spec import TableSpec


@dataclass(frozen=True)
class Demand:
    """Who is needed for what, under some facts."""

    gone: dict[str, str]
    """{stage: why it is not needed}; sequence-wide stages only by their own word."""
    read: frozenset[str]
    """Outputs, as declared, that are asked for by name or that a needed stage reads."""

    @classmethod
    def of(cls, params: Callable[[Stage], Any], facts: Facts, asked: frozenset[str]) -> Demand:
        """From the last stage to the first. `asked`: stages and outputs that are named."""
        gone: dict[str, str] = {}
        read = set(asked)
        for stage in reversed(STAGES):
            why = stage.unneeded(params(stage), facts)
            if why is None and not stage.sequence_wide and stage.name not in asked:
                made = stage.writes_for(facts)
                if not any(w.name in read or isinstance(w, TableSpec) or w.keep != "until_done" for w in made):
                    why = f"no stage reads what it makes ({', '.join(w.name for w in made)}) under these settings"
            if why is not None:
                gone[stage.name] = why
            else:
                read |= {r.array for r in stage.reads_for(params(stage), facts) if not r.is_source}
        return cls(gone, frozenset(read))

    def idle(self, effect: str) -> str | None:
        """Why an effect that could be on would change nothing, or None."""
        stages = [s for s in STAGES if any(e.name == effect for e in s.effects)]
        needed = [s for s in stages if s.name not in self.gone]
        drawn = [w.name for s in needed for w in s.writes if w.when == effect]
        if not needed:
            return f"{' and '.join(s.name for s in stages)} {'is' if len(stages) == 1 else 'are'} not needed"
        used = any(w in self.read for w in drawn) or any(all(w.when != effect for w in s.writes) for s in needed)
        return None if used else f"no stage reads {' and '.join(drawn)} under these settings"
