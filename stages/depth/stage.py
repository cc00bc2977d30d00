"""Declaration of the depth stage."""

from __future__ import annotations

from stages.contract import Facts, Read, Resources, Stage
from stages.depth.params import DepthParams
from storage.spec import ArraySpec, Shape


def needs(shape: Shape, params: DepthParams) -> Resources:
    """Pictures, masks and results of all views (10 bytes a pixel), one frame's hulls and matches (64) and one pair being matched (600; measured: half)."""
    pixels = shape["y"] * shape["x"]
    return Resources(cpu=1, ram=pixels * (shape["frame"] * shape["view"] * 10 + shape["view"] * 64 + 600))


def refusal(params: DepthParams, facts: Facts) -> str | None:
    """True depth exists for simulated captures only."""
    if params.method == "truth" and "truth_depth" not in facts:
        return "depth.method is truth, but the capture has no true depth for every source view (only simulated captures have); use sgbm or hull"
    return None


STAGE = Stage(
    name="depth",
    summary="Estimate metric depth and its confidence for every source view.",
    version=1,
    run="stages.depth.run:run",
    check="stages.depth.run:check",
    reads=(
        Read("frames/color", when=lambda p, f: p.method == "sgbm"),
        Read("frames/mask"),
        Read("truth/depth", when=lambda p, f: p.method == "truth"),
    ),
    writes=(
        ArraySpec("depth/depth", ("frame", "view", "y", "x"), "float32", "m", "Depth along the optical axis; 0 where there is no surface."),
        ArraySpec("depth/confidence", ("frame", "view", "y", "x"), "float16", "1", "0 = no surface, 1 = certain."),
    ),
    over=("sequence", "time"),
    params=DepthParams,
    needs=needs,
    refusal=refusal,
)
