"""Settings of the rendering stage."""

from __future__ import annotations

from typing import Literal

from posegaussian.stages.contract.declaration import Params, setting

GAUSSIANS, IBR, FIT = "gaussians", "ibr", "3dgs"
"""What pictures are drawn from."""


class RenderingParams(Params):
    """Which pictures, from how many views, how exactly."""

    paths: list[str] | None = setting(
        None,
        'Camera paths to render: "between", "held_out", "orbit", "arc CAM_A CAM_B", "still CAM", "sway [CAM'
        ' [DEGREES]]", or a JSON file of cameras. null: held_out where there are held-out cameras, else between the'
        " source cameras that stand side by side, or sway where no two within 75 degrees can be matched.",
        volatile=True,
    )
    sources: int = setting(
        2,
        "Source views whose Gaussians make one picture, nearest in angle first; of what one of them cuts off by its"
        " border, the next nearest that shows it.",
        quality_levels=[1, 2, 3, 4],
        ge=1,
        le=16,
    )
    precision: Literal["float32", "float64"] = setting(
        "float32", "Arithmetic of the rasterizer.", quality_levels=["float32", "float64"]
    )
    method: Literal["gaussians", "ibr", "3dgs"] = setting(
        GAUSSIANS,
        "What pictures are drawn from: our Gaussians; ibr: the source pictures, blended over the masks' hull; 3dgs:"
        " Gaussians fitted to each frame's source pictures from points of its depth. To measure other methods by.",
    )
    fit_steps: int = setting(
        3000,
        "Steps of one source picture each that 3dgs is fitted with; 30000 are published.",
        unit="steps",
        ge=1,
        le=100000,
    )
