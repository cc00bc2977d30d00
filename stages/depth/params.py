"""Settings of the depth stage."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from stages.contract import Facts, Params, setting


class DepthParams(Params):
    """Which geometry, and how much of it."""

    method: Literal["sweep", "sgbm", "hull", "truth"] = setting(
        "sgbm",
        "sweep: offsets from the visual hull, compared with several neighbours at once; sgbm: semi-global matching of rectified pairs, bounded by the hull; hull: the hull's surface alone; truth: the simulator's depth, a diagnostic.",
        quality_levels=["hull", "sgbm", "sweep"],
    )
    pairs: int = setting(2, "Neighbouring views each view is compared with.", quality_levels=[1, 2], ge=1, le=4)
    max_angle: float = setting(66.0, "Widest angle at the subject between two views that are matched.", unit="degrees", gt=0, lt=180)
    consistency: float = setting(1.5, "Disagreement with the other views above which a match is dropped.", unit="px", gt=0)
    depth_range: tuple[float, float] | None = setting(None, "Nearest and farthest depth searched where there are no masks; null: 0.6 to 2 times the distance of the point the cameras look at.", unit="m")

    @field_validator("depth_range")
    @classmethod
    def _ascending(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not 0 < value[0] < value[1]:
            raise ValueError(f"depth_range {list(value)} m must be [nearest, farthest] with 0 < nearest < farthest")
        return value


def refusal(params: DepthParams, facts: Facts) -> str | None:
    """True depth exists for simulated captures only."""
    if params.method == "truth" and "truth_depth" not in facts:
        return "depth.method is truth, but the capture has no true depth for every source view (only simulated captures have); use sweep, sgbm or hull"
    return None
