"""Declaration of the rendering stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical
from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D, Facts
from posegaussian.stages.contract.reading import bytes_together
from posegaussian.stages.frames.effects import NOISE_AVERAGING
from posegaussian.stages.network.params import TWISTED, depth_reads
from posegaussian.stages.rendering.effects import (
    ANTI_ALIASING,
    HOLE_FILLING,
    OUTLINE_EVENING,
    POSE_BLENDING,
    SILHOUETTE_CLIPPING,
    SOURCE_DETAIL,
    SURFACE_CLOSING,
)
from posegaussian.stages.rendering.facts import FITTED
from posegaussian.stages.rendering.params import FIT, GAUSSIANS, RenderingParams
from posegaussian.stages.rendering.paths import PATHS
from posegaussian.stages.rendering.pose_blending import PAST
from posegaussian.stages.rendering.sources import COUNTS, OF_GAUSSIANS, OUTCOME, REFINED, REFINEMENT, TWIST, map_bytes
from posegaussian.storage.model.spec import ArraySpec, Shape

OF_MASKS = (SOURCE_DETAIL, SURFACE_CLOSING, SILHOUETTE_CLIPPING, HOLE_FILLING, OUTLINE_EVENING)
"""Effects that look at the source masks."""


def needs(shape: Shape, params: RenderingParams) -> Resources:
    """The maps and lists of refined Gaussians that are read at once, and of one view those before them, the masks of
    the partition and the lifted Gaussians of one frame, of all source views; one picture's Gaussians; the pictures; the
    source pictures that detail is looked up in, and the look."""
    pixels = shape["y"] * shape["x"]
    wide = 8 if params.precision == "float64" else 4
    # A refined frame draws at most one of four pixels of all views, and of fewer than eight as many as those have.
    lifted = pixels * shape["view"] * 24 * wide
    picture = (
        pixels * max(params.sources, shape["view"] / 4, 8 / 4) * 64 * wide
        + shape["camera_y"] * shape["camera_x"] * 20 * wide
    )
    detail = pixels * shape["view"] * 20 + shape["camera_y"] * shape["camera_x"] * 200
    # Of the refined 31 bytes a Gaussian and 4 for its place, of a quarter of the pixels at most.
    read = bytes_together(shape["frame"], map_bytes(pixels, shape["view"])) * (1 + 35 / 4 / 28)
    maps_and_output = (
        read * (1 + 1 / shape["view"])
        + shape["frame"] * pixels * shape["view"]
        + shape["frame"] * shape["camera"] * shape["camera_y"] * shape["camera_x"] * 4
    )
    return Resources(
        cpu=1,
        gpu=1,
        ram=int(maps_and_output + lifted + picture + detail + pixels * shape["view"] * 12),
        vram=int(lifted + picture + 2**28),
    )


def _ours(params: RenderingParams, facts: Facts) -> bool:
    """Whether pictures are drawn from our Gaussians."""
    return params.method == GAUSSIANS


STAGE = Stage(
    name="rendering",
    summary="Render novel views from the Gaussians of the nearest source views.",
    version=13,
    run="posegaussian.stages.peers.run:run",
    check="posegaussian.stages.rendering.run:check",
    reads=(
        Read("frames/color"),
        *(Read(name, when=_ours) for name in OF_GAUSSIANS),
        Read(TWIST, when=lambda p, f: _ours(p, f) and TWISTED in f),
        *depth_reads(),
        *(Read(name, when=lambda p, f: _ours(p, f) and REFINEMENT in f) for name in (*REFINED, COUNTS, OUTCOME)),
        Read(
            "frames/mask",
            when=lambda p, f: not _ours(p, f) or bool(f & {e.name for e in OF_MASKS}),
        ),
        Read(
            "pose/joints3d",
            when=lambda p, f: bool({SURFACE_CLOSING.name, POSE_BLENDING.name} & f) and bool({JOINTS2D, JOINTS3D} & f),
        ),
        Read(
            "pose/joints2d",
            halo=(PAST, 0),
            when=lambda p, f: POSE_BLENDING.name in f and bool({JOINTS2D, JOINTS3D} & f),
        ),
    ),
    writes=(
        ArraySpec(
            "rendering/{path}/color",
            ("frame", "camera", "camera_y", "camera_x", "rgb"),
            "uint8",
            "sRGB",
            "Rendered picture, premultiplied on black.",
        ),
        ArraySpec("rendering/{path}/alpha", ("frame", "camera", "camera_y", "camera_x"), "uint8", "1/255", "Coverage."),
        ArraySpec(
            "rendering/{path}/gaussians",
            ("frame",),
            "int32",
            "1",
            "Gaussians that were fitted to the frame's pictures.",
            when=FITTED,
        ),
    ),
    over=("sequence", "time", "path"),
    params=RenderingParams,
    needs=needs,
    typical=Typical(seconds=1.9e-6, ratio=0.25),
    effects=(NOISE_AVERAGING, POSE_BLENDING, *OF_MASKS, ANTI_ALIASING),
    paths=PATHS,
    facts=lambda capture, views, params, facts: [FITTED] if params.method == FIT else [],
)
