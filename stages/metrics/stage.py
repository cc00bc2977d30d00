"""Declaration of the metrics stage."""

from __future__ import annotations

from stages.contract import Facts, Read, Resources, Stage
from stages.metrics.params import MetricsParams
from storage.spec import Shape, TableSpec


def needs(shape: Shape, params: MetricsParams) -> Resources:
    """Two pictures of one camera per frame, and a dozen float64 planes for SSIM."""
    return Resources(cpu=1, ram=shape["frame"] * shape["y"] * shape["x"] * 8 + shape["y"] * shape["x"] * 3 * 8 * 12)


def unneeded(params: MetricsParams, facts: Facts) -> str | None:
    """Metrics compare with pictures that were kept aside."""
    return None if "held_out" in facts else "there is no truth: no camera in views.held_out"


STAGE = Stage(
    name="metrics",
    summary="Measure rendered held-out views against their pictures.",
    version=1,
    run="stages.metrics.run:run",
    check="stages.metrics.run:check",
    reads=(
        Read("rendering/{path}/color", halo=(1, 0)),
        Read("frames/color", views="held_out", halo=(1, 0)),
        Read("frames/mask", views="held_out", halo=(1, 0)),
    ),
    writes=(
        TableSpec(
            "metrics/{path}",
            (("camera", "string"), ("frame", "int64"), ("region", "string"), ("measure", "string"), ("value", "float64"), ("background", "string"), ("definition", "string")),
            "One measure of one region of one rendered picture; frame is the sequence's index.",
        ),
    ),
    over=("sequence", "time", "path"),
    params=MetricsParams,
    needs=needs,
    unneeded=unneeded,
)
