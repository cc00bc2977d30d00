"""Declaration of the metrics stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Facts, Read, Resources, Stage
from posegaussian.stages.metrics.flip import missing
from posegaussian.stages.metrics.optional_metrics import without_weights
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.storage.model.spec import Shape, TableSpec

BYTES = {"psnr": 100, "ssim": 288, "delta_ssim": 288, "ms_ssim": 340, "flip": 210, "lpips_alex": 200, "lpips_vgg": 1800}
"""Bytes of working memory a pixel, by measure, as `benchmarks/quality/metrics_time.py` finds them; one is taken
after the other."""
WEIGHTS = {"lpips_alex": 260 * 10**6, "lpips_vgg": 620 * 10**6}
"""Bytes of the weight files, which are read as a whole, and of what is kept of them."""


def needs(shape: Shape, params: MetricsParams) -> Resources:
    """Two pictures of one camera per frame, the working memory of the dearest measure, and the weights of networks."""
    pixels = shape["y"] * shape["x"]
    working = max(BYTES[m] for m in (*params.measures, "ssim"))
    weights = sum(WEIGHTS[m] for m in params.measures if m in WEIGHTS and not without_weights(m, params))
    return Resources(cpu=1, ram=shape["frame"] * pixels * 8 + pixels * working + weights)


def halo(params: MetricsParams) -> tuple[int, int]:
    """The previous frame, where a measure compares with it."""
    return (1, 0) if params.of_neighbours else (0, 0)


def unneeded(params: MetricsParams, facts: Facts) -> str | None:
    """Metrics compare with pictures that were kept aside."""
    return None if "held_out" in facts else "there is no truth: no camera in views.held_out"


def refusal(params: MetricsParams, facts: Facts) -> str | None:
    """FLIP without its package, and weights of LPIPS without their sha256 or the other way round."""
    if "flip" in params.measures and (sentence := missing()) is not None:
        return sentence
    for there, other in (("lpips_weights", "lpips_sha256"), ("lpips_sha256", "lpips_weights")):
        if left := [name for name in getattr(params, there) if name not in getattr(params, other)]:
            what = "the sha256 that `sha256sum FILE` prints" if other == "lpips_sha256" else "the path of the file"
            return f"metrics.{there} has {', '.join(left)}, metrics.{other} has not; give {what} there, too"
    return None


STAGE = Stage(
    name="metrics",
    summary="Measure rendered held-out views against their pictures.",
    version=1,
    run="posegaussian.stages.metrics.run:run",
    check="posegaussian.stages.metrics.run:check",
    reads=(
        Read("rendering/{path}/color", halo=halo),
        Read("frames/color", views="held_out", halo=halo),
        Read("frames/mask", views="held_out", halo=halo),
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
    unneeded=unneeded,
    refusal=refusal,
)
