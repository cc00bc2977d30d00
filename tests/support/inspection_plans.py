"""What a run would make of made rigs."""

from __future__ import annotations

from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.inspection.planned import Planned
from posegaussian.storage.model.cameras import Rig


def planned(
    rig: Rig,
    matte: str = "given",
    estimator: str = "files",
    sources: tuple[int, ...] | None = None,
    facts: frozenset[str] = frozenset({"joints2d"}),
    **depth: object,
) -> Planned:
    every = tuple(range(len(rig)))
    settings = DepthParams.model_validate({"method": "sgbm"} | depth)
    return Planned(
        rig,
        every,
        every if sources is None else sources,
        settings,
        (matte, "it is said"),
        (estimator, "it is said"),
        facts,
    )
