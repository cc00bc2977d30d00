"""Declaration of the metrics stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical
from posegaussian.stages.contract.facts import HELD_OUT, Facts
from posegaussian.stages.metrics.measures.registry import METRICS
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.storage.model.spec import Shape, TableSpec


def needs(shape: Shape, params: MetricsParams) -> Resources:
    """Two pictures of one camera and all masks per frame, the working memory of the dearest measure, copies that are
    black beyond the mask (48 bytes a pixel), and the weights of networks."""
    pixels = shape["y"] * shape["x"]
    working = max(METRICS[m].bytes_a_pixel for m in (*params.measures, "ssim"))
    kept = sum(METRICS[m].kept_bytes(params) for m in params.measures)
    return Resources(cpu=1, ram=shape["frame"] * pixels * (8 + shape["view"]) + pixels * (working + 48) + kept)


def halo(params: MetricsParams, facts: Facts) -> tuple[int, int]:
    """The previous frame, where a measure compares with it."""
    return (1, 0) if params.of_neighbours else (0, 0)


def unneeded(params: MetricsParams, facts: Facts) -> str | None:
    """Metrics compare with pictures that were kept aside."""
    return None if HELD_OUT in facts else "there is no truth: no camera in views.held_out"


def refusal(params: MetricsParams, facts: Facts) -> str | None:
    """A measure that cannot be taken here, and weights of LPIPS without their sha256 or the other way round."""
    for name in params.measures:
        if (sentence := METRICS[name].refusal(params)) is not None:
            return sentence
    for there, other in (("lpips_weights", "lpips_sha256"), ("lpips_sha256", "lpips_weights")):
        if left := [name for name in getattr(params, there) if name not in getattr(params, other)]:
            what = "the sha256 that `sha256sum FILE` prints" if other == "lpips_sha256" else "the path of the file"
            return f"metrics.{there} has {', '.join(left)}, metrics.{other} has not; give {what} there, too"
    return None


STAGE = Stage(
    name="metrics",
    summary="Measure rendered held-out views against their pictures.",
    version=7,
    run="posegaussian.stages.metrics.run:run",
    check="posegaussian.stages.metrics.run:check",
    reads=(
        Read("rendering/{path}/color", halo=halo),
        Read("frames/color", views="held_out", halo=halo),
        Read("frames/mask", views="compared", halo=halo),
    ),
    writes=(
        TableSpec(
            "metrics/{path}",
            (
                ("camera", "string"),
                ("frame", "int64"),
                ("region", "string"),
                ("measure", "string"),
                ("value", "float64"),
                ("background", "string"),
                ("definition", "string"),
            ),
            "One measure of one region of one rendered picture; frame is the sequence's index; without a value where"
            " the definition says that it is not available.",
        ),
    ),
    over=("sequence", "time", "path"),
    params=MetricsParams,
    needs=needs,
    typical=Typical(seconds=1e-6),
    unneeded=unneeded,
    refusal=refusal,
)
