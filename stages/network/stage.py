"""Declaration of the network stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical
from posegaussian.stages.contract.facts import GIVEN_DEPTH, JOINTS2D, JOINTS3D, SINGLE_SOURCE, Facts
from posegaussian.stages.contract.reading import bytes_together
from posegaussian.stages.network.asset import SHIPPED_NETWORKS, TRAINED, card_of, facts_of
from posegaussian.stages.network.asset import notes as weights_notes
from posegaussian.stages.network.choice import WEIGHTS, settled
from posegaussian.stages.network.model.presets import TRAINED_SIDE, Preset
from posegaussian.stages.network.params import AUTO, NETWORK, NONE, QUATERNIONS, TURNED, NetworkParams, shown_bytes
from posegaussian.stages.network.precision import PRECISION
from posegaussian.stages.pose.effects import POSE_HEATMAPS
from posegaussian.stages.smoothing.effects import TEMPORAL_SMOOTHING
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: NetworkParams) -> Resources:
    """What frames that are read together show, all views' results, one frame's at full precision, and the features of
    one pair at the size it is looked at (`fast` takes 0.26 kB a pixel of both windows, `base` 0.51, 0.77 in float32,
    measured at 512 px)."""
    pixels, views = shape["y"] * shape["x"], shape["view"]
    pair = int(pixels * min(1.0, TRAINED_SIDE / max(shape["y"], shape["x"])) ** 2 * 2500)
    shown = bytes_together(shape["frame"], shown_bytes(shape["y"], shape["x"], views))
    return Resources(
        cpu=1,
        gpu=1,
        ram=shown + pixels * (shape["frame"] * views * 28 + views * 64) + pair + 2**28,
        vram=pair + 2**28,
    )


def unneeded(params: NetworkParams, facts: Facts) -> str | None:
    """Without weights depth and Gaussians stay the analytic ones; a single view has no pair, and most weights nothing
    to say about it."""
    answer = settled(params, facts)
    if answer.weights == NONE and params.weights == AUTO:
        return "network.weights auto came to none: depth and Gaussians are the analytic ones"
    if answer.weights == NONE:
        return "network.weights is none: depth and Gaussians are the analytic ones"
    if SINGLE_SOURCE not in facts:
        return None
    if GIVEN_DEPTH in facts:
        return "there is a single source view, with depth maps of its own, which no weights were trained to refine"
    if not Preset.from_json(card_of(answer).network).alone:
        return f"there is a single source view: {answer.weights} was trained to compare pairs"
    return None


def _heatmaps(params: NetworkParams, facts: Facts) -> bool:
    return POSE_HEATMAPS.name in facts and bool({JOINTS2D, JOINTS3D} & facts)


STAGE = Stage(
    name=NETWORK,
    summary="Refine depth and Gaussians by what the trained network sees in pairs of views.",
    version=11,
    run="posegaussian.stages.network.run:run",
    check="posegaussian.stages.network.run:check",
    reads=(
        Read("frames/color"),
        Read("frames/mask"),
        Read("depth/depth"),
        Read("depth/confidence"),
        Read("smoothing/heatmaps", when=lambda p, f: TEMPORAL_SMOOTHING.name in f and _heatmaps(p, f)),
        Read("pose/heatmaps", when=_heatmaps),
        Read.source("network"),
    ),
    writes=(
        ArraySpec(
            "network/depth",
            ("frame", "view", "y", "x"),
            "float32",
            "m",
            "Depth along the optical axis, the network's blended over the analytic one; 0 where there is no surface.",
        ),
        ArraySpec(
            "network/confidence",
            ("frame", "view", "y", "x"),
            "float16",
            "1",
            "Probability that the network's depth is nearer to the truth than the analytic one; 0 where none is said.",
            keep="until_done",
        ),
        ArraySpec(
            "network/share",
            ("frame", "view", "one"),
            "float32",
            "1",
            "Mean of that probability over the view's surface; 0 without one.",
        ),
        ArraySpec(
            "network/blend",
            ("frame", "view", "y", "x"),
            "float16",
            "1",
            "Share of what the heads say of scale, rotation and opacity; 0 = the analytic ones alone.",
            keep="until_done",
        ),
        ArraySpec(
            "network/numbers",
            ("frame", "view", "heads", "y", "x"),
            "float16",
            "1",
            "What the heads of scale (3), rotation (3) and opacity (2) say; `posegaussian.stages.network.model.heads`"
            " gives it its meaning. Of a quaternion it has the last three, of a single opacity that one and 0.",
            keep="until_done",
        ),
        ArraySpec(
            "network/turn",
            ("frame", "view", "one", "y", "x"),
            "float16",
            "1",
            "What a rotation head of quaternions says first.",
            keep="until_done",
            when=QUATERNIONS,
        ),
        ArraySpec(
            "network/axes",
            ("frame", "view", "one"),
            "float32",
            "rad",
            "Turn in the picture, from x towards y, of the axes that the heads' sizes and normals are said along.",
            when=TURNED,
        ),
    ),
    over=("sequence", "time"),
    params=NetworkParams,
    needs=needs,
    typical=Typical(seconds=1e-6, ratio=0.15),
    unneeded=unneeded,
    effects=(POSE_HEATMAPS, TEMPORAL_SMOOTHING),
    optional=True,
    notes=lambda evidence: weights_notes(settled(evidence.params, evidence.facts)),
    assets=(TRAINED, SHIPPED_NETWORKS),
    choices=(WEIGHTS, PRECISION),
    facts=lambda capture, views, params, facts: facts_of(capture.rig, views.sources, params),
)
