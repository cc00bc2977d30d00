"""Declaration of the gaussians stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.network.params import NETWORK, QUATERNIONS, depth_reads
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: GaussiansParams) -> Resources:
    """One view's partition: depth, confidence and mask in, nine channels out, in float32 while they are computed."""
    return Resources(cpu=1, ram=shape["frame"] * shape["y"] * shape["x"] * 30 + shape["y"] * shape["x"] * 120)


STAGE = Stage(
    name="gaussians",
    summary="Turn depth into pixel-aligned Gaussians: scale, normal, opacity.",
    version=1,
    run="posegaussian.stages.gaussians.run:run",
    check="posegaussian.stages.gaussians.run:check",
    reads=(
        *depth_reads(),
        Read("network/numbers", when=lambda p, f: NETWORK in f),
        Read("network/turn", when=lambda p, f: NETWORK in f and QUATERNIONS in f),
        Read("network/confidence", when=lambda p, f: NETWORK in f),
        Read("depth/confidence"),
        Read("frames/mask"),
    ),
    writes=(
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
            when=QUATERNIONS,
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
)
