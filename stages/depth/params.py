"""Settings of the depth stage, and how `method: auto` is resolved."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from posegaussian.stages.contract.declaration import Facts, Params, setting
from posegaussian.stages.contract.facts import GIVEN_DEPTH, SINGLE_SOURCE

Method = Literal["given", "sgbm", "sweep", "hull", "relief", "truth"]
MATCHING, SEVERAL = ("sgbm", "sweep"), ("sgbm", "sweep", "hull")
"""Methods that compare pictures, and those that take several source views."""


class DepthParams(Params):
    """Which geometry, and how much of it."""

    method: Literal["auto", Method] = setting(
        "auto",
        "given: depth maps that came with the capture; sweep: offsets from the visual hull, compared with several"
        " neighbours at once; sgbm: semi-global matching of rectified pairs, bounded by the hull; hull: the hull's"
        " surface alone; relief: a single view's silhouette, rounded; truth: the simulator's depth, a diagnostic; auto:"
        " given, else relief for a single source view, else sgbm.",
        quality_levels=["hull", "sgbm", "sweep"],
    )
    pairs: int = setting(2, "Neighbouring views each view is compared with.", quality_levels=[1, 2], ge=1, le=4)
    max_angle: float = setting(
        66.0, "Widest angle at the subject between two views that are matched.", unit="degrees", gt=0, lt=180
    )
    consistency: float = setting(
        1.5, "Disagreement with the other views above which a match is dropped.", unit="px", gt=0
    )
    depth_range: tuple[float, float] | None = setting(
        None,
        "Nearest and farthest depth: of given depth maps what is kept, without masks what is searched; null:"
        " everything, and 0.6 to 2 times the distance of the point the cameras look at.",
        unit="m",
    )
    subject_distance: float | None = setting(
        None,
        "From a single source camera to the subject, along its axis: where a relief lies and what `sway` turns about;"
        " null: where a person of 1.8 m fills three quarters of the picture's longer side.",
        unit="m",
        gt=0.05,
        lt=1e4,
    )

    @field_validator("depth_range")
    @classmethod
    def _ascending(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not 0 < value[0] < value[1]:
            raise ValueError(f"depth_range {list(value)} m must be [nearest, farthest] with 0 < nearest < farthest")
        return value


def method_choice(params: DepthParams, facts: Facts) -> tuple[Method, str]:
    """The method and one sentence that says why; for the table of effects."""
    if params.method != "auto":
        return params.method, f"depth.method is {params.method}"
    if GIVEN_DEPTH in facts:
        return "given", "the capture came with depth maps of every source view" + (
            "" if SINGLE_SOURCE in facts else "; depth.method: sgbm would match the views instead"
        )
    if SINGLE_SOURCE in facts:
        return (
            "relief",
            (
                "a single source view and no depth maps: its silhouette, rounded, at an assumed distance"
                " (depth.subject_distance)"
            ),
        )
    return "sgbm", "no depth maps came with the capture, and pairs of source views can be matched"


def resolve_method(params: DepthParams, facts: Facts) -> Method:
    """What `auto` means for this capture."""
    return method_choice(params, facts)[0]


def refusal(params: DepthParams, facts: Facts) -> str | None:
    """True depth exists for simulated captures only, given depth where it came with every source view; a single view
    compares with nothing."""
    if params.method == "truth" and "truth_depth" not in facts:
        return (
            "depth.method is truth, but the capture has no true depth for every source view (only simulated captures"
            " have); use auto"
        )
    if params.method == "given" and GIVEN_DEPTH not in facts:
        return (
            "depth.method is given, but not every source view has depth maps (layout images:"
            " depth_maps/CAMERA/000000.exr); import them, leave the others out of views.sources, or use auto"
        )
    if params.method in SEVERAL and SINGLE_SOURCE in facts:
        return (
            f"depth.method is {params.method}, but there is a single source view, which nothing can be compared with;"
            " use auto (depth maps if the capture has them, else a relief of the silhouette)"
        )
    if params.method == "relief" and SINGLE_SOURCE not in facts:
        return (
            "depth.method is relief, but there are several source views, whose reliefs would contradict each other; use"
            " auto"
        )
    return None
