"""Declaration of the depth stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical
from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D, Facts
from posegaussian.stages.depth.choice import METHOD
from posegaussian.stages.depth.effects import LEFT_RIGHT_CHECK, LIMB_BOUNDS
from posegaussian.stages.depth.methods.registry import METHODS
from posegaussian.stages.depth.notes import notes
from posegaussian.stages.depth.params import AUTO, DepthParams, refusal, resolve_method
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: DepthParams) -> Resources:
    """Pictures, masks and results of all views (10 bytes a pixel), one frame's hulls and matches (64) and what the
    method works in."""
    pixels = shape["y"] * shape["x"]
    working = max(m.working for m in METHODS.values() if params.method in (AUTO, m.name))
    return Resources(cpu=1, ram=pixels * (shape["frame"] * shape["view"] * 10 + shape["view"] * 64 + working))


def _of_method(array: str) -> Read:
    """An array that only some methods read."""

    def when(params: DepthParams, facts: Facts) -> bool:
        return array in resolve_method(params, facts).reads

    return Read(array, when=when)


STAGE = Stage(
    name="depth",
    summary="Estimate metric depth and its confidence for every source view.",
    version=8,
    run="posegaussian.stages.depth.run:run",
    check="posegaussian.stages.depth.run:check",
    reads=(
        Read("frames/mask"),
        Read("pose/joints3d", when=lambda p, f: LIMB_BOUNDS.name in f and bool({JOINTS2D, JOINTS3D} & f)),
        *(_of_method(a) for a in dict.fromkeys(a for m in METHODS.values() for a in m.reads)),
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
    typical=Typical(seconds=3.6e-6, ratio=0.15),
    refusal=refusal,
    effects=(LEFT_RIGHT_CHECK, LIMB_BOUNDS),
    choices=(METHOD,),
    notes=notes,
)
