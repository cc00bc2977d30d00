"""Declaration of the gaussians stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.frames.effects import NOISE_AVERAGING, UNREST
from posegaussian.stages.frames.facts import AVERAGED_WITH
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.network.params import NETWORK, QUATERNIONS, TURNED, TWISTED, found_depth_reads
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: GaussiansParams) -> Resources:
    """One view's partition: depth, confidence and mask in, nine channels out, in float32 while they are computed; with
    its halo, pictures, depth and confidence that are averaged."""
    frames = shape["frame"] * 45 + 2 * AVERAGED_WITH * 15
    return Resources(cpu=1, ram=shape["y"] * shape["x"] * (frames + 120 + 16 * (2 * AVERAGED_WITH + 1)))


def _averaged(params: GaussiansParams, facts: Facts) -> bool:
    return NOISE_AVERAGING.name in facts


def halo(params: GaussiansParams, facts: Facts) -> tuple[int, int]:
    """Frames around the partition whose depth is averaged with its own."""
    return (AVERAGED_WITH, AVERAGED_WITH) if _averaged(params, facts) else (0, 0)


STAGE = Stage(
    name="gaussians",
    summary="Turn depth into pixel-aligned Gaussians: scale, normal, opacity.",
    version=4,
    run="posegaussian.stages.gaussians.run:run",
    check="posegaussian.stages.gaussians.run:check",
    reads=(
        *found_depth_reads(halo),
        Read("network/numbers", when=lambda p, f: NETWORK in f),
        Read("network/turn", when=lambda p, f: NETWORK in f and QUATERNIONS in f),
        Read("network/axes", when=lambda p, f: NETWORK in f and TURNED in f),
        Read("network/blend", when=lambda p, f: NETWORK in f),
        Read("depth/confidence", halo=halo),
        Read("frames/mask"),
        Read("frames/color", halo=halo, when=_averaged),
        Read(UNREST, when=_averaged),
    ),
    writes=(
        ArraySpec(
            "gaussians/depth",
            ("frame", "view", "y", "x"),
            "float32",
            "m",
            "Depth along the optical axis, averaged over time where pictures show the same; 0 where there is none.",
            when=NOISE_AVERAGING.name,
        ),
        ArraySpec(
            "gaussians/scale",
            ("frame", "view", "axis", "y", "x"),
            "float16",
            "m",
            "Standard deviations along (tangent, tangent, normal).",
            keep="until_done",
        ),
        ArraySpec(
            "gaussians/rotation",
            ("frame", "view", "axis", "y", "x"),
            "float16",
            "1",
            "Unit normal in camera axes, facing the camera; it is the Gaussian's third axis.",
            keep="until_done",
        ),
        ArraySpec(
            "gaussians/twist",
            ("frame", "view", "turn", "y", "x"),
            "float16",
            "1",
            "Cosine and sine of the turn about the normal, away from the tangents that follow from it.",
            keep="until_done",
            when=TWISTED,
        ),
        ArraySpec(
            "gaussians/opacity",
            ("frame", "view", "faces", "y", "x"),
            "float16",
            "1",
            "Opacity seen face-on and at grazing angle.",
            keep="until_done",
        ),
        ArraySpec(
            "gaussians/confidence",
            ("frame", "view", "one", "y", "x"),
            "float16",
            "1",
            "Share of the learned value in the blend; 0 = the prior alone.",
            keep="until_done",
        ),
    ),
    over=("sequence", "time"),
    params=GaussiansParams,
    needs=needs,
    typical=Typical(seconds=5e-7, ratio=0.1),
    effects=(NOISE_AVERAGING,),
)
