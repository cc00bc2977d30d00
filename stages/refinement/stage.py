"""Declaration of the refinement stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical, Unit
from posegaussian.stages.contract.facts import FEW_SOURCES, REFINING, Facts
from posegaussian.stages.contract.reading import bytes_together
from posegaussian.stages.frames.effects import NOISE_AVERAGING
from posegaussian.stages.network.params import TWISTED, depth_reads
from posegaussian.stages.refinement.params import COVERED, FEWEST, RefinementParams, halo, optimised_bytes
from posegaussian.stages.rendering.sources import COUNTS, REFINEMENT, TWIST, map_bytes
from posegaussian.storage.model.spec import LISTED, ArraySpec, Shape

REHEARSAL = 1.1
"""What a rehearsal takes, of what a frame does. A task begins with one; it has more only where its partition spans
several groups."""


def needs(shape: Shape, params: RefinementParams) -> Resources:
    """Maps that are read at once, the lists of the partition as if no frame were refined, so that every pixel with
    depth is written, and one frame's optimisation, which lies on the device where there is one."""
    pixels = shape["y"] * shape["x"]
    frame = map_bytes(pixels, shape["view"])
    maps = bytes_together(shape["frame"], frame)
    lists = int(COVERED * frame) * shape["frame"]
    optimised = optimised_bytes(pixels, shape["view"], params)
    return Resources(cpu=1, gpu=1, ram=maps + lists + optimised, vram=optimised + 2**28)


def unneeded(params: RefinementParams, facts: Facts) -> str | None:
    """Without steps rendering takes the Gaussians as they are; of fewer than three source views none can judge."""
    if not params.steps:
        return "refinement.steps is 0: rendering takes the Gaussians as they are"
    if FEW_SOURCES in facts:
        return f"there are fewer than {FEWEST} source views: refinement wants one that judges and two that teach"
    return None


STAGE = Stage(
    name=REFINEMENT,
    summary="Optimise each frame's Gaussians on its source pictures through the renderer.",
    version=21,
    run="posegaussian.stages.refinement.run:run",
    check="posegaussian.stages.refinement.run:check",
    reads=(
        *(
            Read(name, halo=halo)
            for name in ("frames/color", "frames/mask", "gaussians/scale", "gaussians/rotation", "gaussians/opacity")
        ),
        Read(TWIST, halo=halo, when=lambda p, f: TWISTED in f),
        *depth_reads(halo),
    ),
    writes=(
        ArraySpec(
            "refinement/color",
            ("frame", "view", LISTED, "rgb"),
            "uint8",
            "sRGB",
            "Colour of each Gaussian.",
            keep="until_done",
        ),
        ArraySpec(
            "refinement/depth",
            ("frame", "view", LISTED),
            "float32",
            "m",
            "Its depth along the optical axis of the view.",
            keep="until_done",
        ),
        ArraySpec(
            "refinement/scale",
            ("frame", "view", LISTED, "axis"),
            "float16",
            "m",
            "Standard deviations along (tangent, tangent, normal).",
            keep="until_done",
        ),
        ArraySpec(
            "refinement/rotation",
            ("frame", "view", LISTED, "axis"),
            "float16",
            "1",
            "Unit normal in camera axes; it is the Gaussian's third axis.",
            keep="until_done",
        ),
        ArraySpec(
            "refinement/opacity",
            ("frame", "view", LISTED, "faces"),
            "float16",
            "1",
            "Opacity seen face-on and at grazing angle.",
            keep="until_done",
        ),
        ArraySpec(
            "refinement/twist",
            ("frame", "view", LISTED, "turn"),
            "float16",
            "1",
            "Cosine and sine of the turn about the normal, away from the tangents that follow from it.",
            keep="until_done",
        ),
        ArraySpec(
            "refinement/shift",
            ("frame", "view", LISTED, "shift"),
            "float16",
            "px",
            "How far right of the pixel's centre, and below it, the point lies that it is of.",
            keep="until_done",
        ),
        ArraySpec(
            "refinement/pixel",
            ("frame", "view", LISTED),
            "int32",
            "px",
            "The pixel of the picture that it is of: row times the width of all pictures, and column.",
            keep="until_done",
        ),
        ArraySpec(
            COUNTS,
            ("frame", "view"),
            "int32",
            "1",
            "Gaussians of each view: how many entries of the lists are used.",
        ),
        ArraySpec(
            "refinement/outcome",
            ("frame", "outcome"),
            "float32",
            "1",
            "Usable source views, index of the judging one (-1: none), its mean squared error before and after the"
            " rehearsal (sRGB 0..1), the steps that were made, whether it rehearsed itself (0: its group did), how many"
            " gradients were not finite, and the refined picture's share 0..1 in what is rendered.",
        ),
    ),
    over=("sequence", "time"),
    params=RefinementParams,
    needs=needs,
    unit=Unit(besides=REHEARSAL),
    typical=Typical(seconds=2.4e-6, ratio=0.2),
    unneeded=unneeded,
    facts=lambda capture, views, params, facts: [] if unneeded(params, facts) else [REFINING],
    effects=(NOISE_AVERAGING,),
    optional=True,
)
