"""Declaration of the depth stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Choice, Read, Resources, Stage
from posegaussian.stages.depth.effects import LEFT_RIGHT_CHECK, LIMB_BOUNDS
from posegaussian.stages.depth.params import MATCHING, DepthParams, method_choice, refusal, resolve_method
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: DepthParams) -> Resources:
    """Pictures, masks and results of all views (10 bytes a pixel), one frame's hulls and matches (64) and one pair
    being matched (600; measured: half)."""
    pixels = shape["y"] * shape["x"]
    return Resources(cpu=1, ram=pixels * (shape["frame"] * shape["view"] * 10 + shape["view"] * 64 + 600))


STAGE = Stage(
    name="depth",
    summary="Estimate metric depth and its confidence for every source view.",
    version=1,
    run="posegaussian.stages.depth.run:run",
    check="posegaussian.stages.depth.run:check",
    reads=(
        Read("frames/color", when=lambda p, f: resolve_method(p, f) in MATCHING),
        Read("frames/mask"),
        Read("frames/depth", when=lambda p, f: resolve_method(p, f) == "given"),
        Read("pose/joints3d", when=lambda p, f: "limb_bounds" in f and bool({"joints2d", "joints3d"} & f)),
        Read("truth/depth", when=lambda p, f: p.method == "truth"),
    ),
    writes=(
        ArraySpec(
            "depth/depth",
            ("frame", "view", "y", "x"),
            "float32",
            "m",
            "Depth along the optical axis; 0 where there is no surface.",
        ),
        ArraySpec("depth/confidence", ("frame", "view", "y", "x"), "float16", "1", "0 = no surface, 1 = certain."),
    ),
    over=("sequence", "time"),
    params=DepthParams,
    needs=needs,
    refusal=refusal,
    effects=(LEFT_RIGHT_CHECK, LIMB_BOUNDS),
    choices=(Choice("method", method_choice),),
)
