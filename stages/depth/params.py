"""Settings of the depth stage, and how `method: auto` is resolved."""

from __future__ import annotations

from pydantic import field_validator

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.contract.facts import SINGLE_SOURCE, Facts, fact
from posegaussian.stages.depth.methods.declaration import DepthMethod
from posegaussian.stages.depth.methods.registry import BY_PICTURES, METHODS

AUTO = "auto"
"""In place of a method's name: the one that suits the capture."""
PICKED = {name: fact(f"{name}_depth") for name in BY_PICTURES}
"""{method: the fact that `auto` comes to it, by pictures of left-out views or for want of them}."""
UNTOLD = (
    "every other camera looks along the same rays, from behind or from the same place: nothing tells how far away the"
    " subject is, and the silhouette is rounded at the point the cameras look at"
)
"""What is said of views whose depth is assumed although they are not the only one."""


class DepthParams(Params):
    """Which geometry, and how much of it."""

    method: str = setting(
        AUTO,
        "; ".join(f"{m.name}: {m.sentence}" for m in METHODS.values())
        + f"; {AUTO}: given, else relief for a single source view, else what draws left-out source views best of"
        f" {', '.join(BY_PICTURES)} (sgbm only where second neighbours stand more than 50 degrees away, and first ones"
        " 66 at most); sweep where none can be left out.",
        quality_levels=list(BY_PICTURES),
    )
    pairs: int = setting(2, "Neighbouring views each view is compared with.", quality_levels=[1, 2], ge=1, le=4)
    max_angle: float = setting(
        105.0, "Widest angle at the subject between two views that are matched.", unit="degrees", gt=0, lt=180
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

    @field_validator("method")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in (AUTO, *METHODS):
            raise ValueError(f"there is no depth method {value!r}; there are {', '.join((AUTO, *METHODS))}")
        return value

    @field_validator("depth_range")
    @classmethod
    def _ascending(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not 0 < value[0] < value[1]:
            raise ValueError(f"depth_range {list(value)} m must be [nearest, farthest] with 0 < nearest < farthest")
        return value


def method_choice(params: DepthParams, facts: Facts) -> tuple[str, str]:
    """The method and one sentence that says why; for the table of effects."""
    if params.method != AUTO:
        return params.method, f"depth.method is {params.method}"
    picked = next((name for name, told in PICKED.items() if told in facts), None)
    if picked is not None:
        return picked, "pictures of left-out source views say so, or what was measured on other captures"
    return next((m.name, why) for m in METHODS.values() if (why := m.auto(facts)) is not None)


def resolve_method(params: DepthParams, facts: Facts) -> DepthMethod:
    """What `auto` means for this capture."""
    return METHODS[method_choice(params, facts)[0]]


def refusal(params: DepthParams, facts: Facts) -> str | None:
    """Why this capture cannot be served by the method that is asked for, or None: what the method itself lacks, and a
    single view, which compares with nothing."""
    if params.method == AUTO:
        return None
    method = METHODS[params.method]
    if (lacking := method.lacks(facts)) is not None:
        return f"depth.method is {method.name}, but {lacking}"
    if method.several and SINGLE_SOURCE in facts:
        return (
            f"depth.method is {method.name}, but there is a single source view, which nothing can be compared with;"
            " use auto (depth maps if the capture has them, else a relief of the silhouette)"
        )
    return None
