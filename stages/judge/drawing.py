"""Pictures of left-out source views, made by the kernels of the later stages, and what they score.

All views' depth is made with all views, as a run makes it; then a view's own Gaussians are left out, and its picture
is drawn from the others'. To leave it out of the matching, too, would judge depth at twice the gap between cameras:
pairs that a run matches would be missing, and what it can see from one side alone. Gaussians and rendering have their
default settings: their own settings are not chosen here, and to change one should leave the depth as it is. What limbs
do for depth and for gaps is as in a run (`posegaussian.stages.judge.body`): without it cameras that stand far apart
leave next to nothing to compare.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.judged import FEWEST, MEASURES, NONE
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.depth.run import run as depth_of
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.gaussians.run import run as gaussians_of
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import measure
from posegaussian.stages.rendering.frame import FrameRenderer, MapReader
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.rendering.run import quantise
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.masks import foreground

PLAIN = MetricsParams(measures=["psnr", "ssim"])
NO_BODY = Facts()


def with_gaussians(frames: Frames, depth: DepthParams, method: str, body: Facts = NO_BODY) -> Frames:
    """The frames with depth of a method, otherwise by the settings given, and the Gaussians that follow; `body`: the
    effects that are on besides."""
    made = frames.with_facts(frames.facts | body)
    made.put(depth_of(made, depth.model_copy(update={"method": method})))
    made.put(gaussians_of(made, GaussiansParams()))
    return made


def scores(made: Frames, filmed: np.ndarray, views: list[int], facts: Facts) -> np.ndarray:
    """[picture, measure] of every frame's `views`, frame by frame, drawn without their own Gaussians while the
    rendering effects among the `facts` are on; `NONE` of a view without a picture, or without two others.

    filmed: [F, V, h, w, 3] what they are compared with.
    """
    found = [_scores(made.without(v).with_facts(made.facts | facts), filmed[:, v], v) for v in views]
    return np.stack(found, axis=1).reshape(-1, len(MEASURES))


def _scores(others: Frames, filmed: np.ndarray, view: int) -> np.ndarray:
    """[F, measure] of one view."""
    out = np.full((len(filmed), len(MEASURES)), NONE)
    (width, height), masks = (int(n) for n in others.rig.size[view]), others.read("frames/mask", view)
    camera = Camera(others.rig.intrinsics[view], others.rig.world_to_camera[view], width, height)
    reader = MapReader(others)
    for f, mask in enumerate(masks[:, :height, :width]):
        if others.valid[f, [*others.views.sources, view]].sum() >= FEWEST and others.valid[f, view]:
            drawn = FrameRenderer(reader, f, RenderingParams()).picture(camera)
            if drawn is not None and foreground(mask).any():
                out[f] = score(quantise(drawn[0]), quantise(drawn[1]), filmed[f, :height, :width], mask)
    return out


def score(
    color: np.ndarray, alpha: np.ndarray, filmed: np.ndarray, mask: np.ndarray, visible: np.ndarray | None = None
) -> tuple[float, float, float]:
    """PSNR in dB and SSIM in the box, and the share of the person covered, of a picture [h, w, 3] uint8 on black with
    alpha [h, w] against a filmed one and its mask [h, w]; `visible` [h, w] bool: pixels that count, all by default.

    The picture is first brought to the filmed one's light, by one gain a channel (least squares inside the mask): what
    a camera's own exposure is, other cameras cannot know, and no seam follows from it.
    """
    inside, picture = foreground(mask), color.astype(np.float64)
    truth = filmed[inside] * (mask[inside, None] / 255.0)
    gains = (truth * picture[inside]).sum(axis=0) / np.maximum((picture[inside] ** 2).sum(axis=0), 1.0)
    values = measure(np.clip(picture * gains, 0, 255), filmed, mask, PLAIN, visible)
    psnr, ssim = (float(values["box", name]) for name in PLAIN.measures)  # type: ignore[arg-type]
    return psnr, ssim, float(foreground(alpha)[inside].mean())
