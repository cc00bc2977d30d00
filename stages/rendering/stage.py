"""Declaration of the rendering stage."""

from __future__ import annotations

from stages.contract import Read, Resources, Stage
from stages.rendering.params import RenderingParams
from storage.spec import ArraySpec, Shape


def needs(shape: Shape, params: RenderingParams) -> Resources:
    """The maps of all source views of a partition, the lifted Gaussians of one frame, and one picture's tiles."""
    pixels = shape["y"] * shape["x"]
    wide = 8 if params.precision == "float64" else 4
    return Resources(cpu=1, gpu=1, ram=shape["frame"] * pixels * shape["view"] * 28 + pixels * params.sources * 30 * wide + 2**29, vram=pixels * params.sources * 30 * wide + 2**29)


STAGE = Stage(
    name="rendering",
    summary="Render novel views from the Gaussians of the nearest source views.",
    version=1,
    run="stages.rendering.run:run",
    check="stages.rendering.run:check",
    reads=(
        Read("frames/color"),
        Read("depth/depth"),
        Read("gaussians/scale"),
        Read("gaussians/rotation"),
        Read("gaussians/opacity"),
    ),
    writes=(
        ArraySpec("rendering/{path}/color", ("frame", "camera", "camera_y", "camera_x", "rgb"), "uint8", "sRGB", "Rendered picture, premultiplied on black."),
        ArraySpec("rendering/{path}/alpha", ("frame", "camera", "camera_y", "camera_x"), "uint8", "1/255", "Coverage."),
    ),
    over=("sequence", "time", "path"),
    params=RenderingParams,
    needs=needs,
)
