"""A relief of a single view's silhouette, at a distance that is assumed."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.facts import SINGLE_SOURCE, Facts
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.depth.methods.declaration import DepthMethod


def _maps(inputs: Inputs, params: SearchSettings, view: int) -> tuple[np.ndarray, np.ndarray]:
    from posegaussian.stages.depth.algorithms.relief import relief
    from posegaussian.stages.geometry.subject import subject_distance

    distance = subject_distance(inputs.rig, view, params.subject_distance)
    focal = float(inputs.rig.intrinsics[view, 0, 0])
    masks = inputs.read("frames/mask", view)
    depth, confidence = np.zeros(masks.shape, np.float32), np.zeros(masks.shape, np.float32)
    width, height = inputs.rig.size[view]
    for f in np.flatnonzero(inputs.valid[:, view]):
        depth[f, :height, :width], confidence[f, :height, :width] = relief(masks[f, :height, :width], distance, focal)
    return depth, confidence


def _lacks(facts: Facts) -> str | None:
    if SINGLE_SOURCE in facts:
        return None
    return "there are several source views, whose reliefs would contradict each other; use auto"


def _auto(facts: Facts) -> str | None:
    if SINGLE_SOURCE not in facts:
        return None
    return (
        "a single source view and no depth maps: its silhouette, rounded, at an assumed distance"
        " (depth.subject_distance)"
    )


METHOD = DepthMethod(
    "relief",
    "a single view's silhouette, rounded",
    of_view=_maps,
    lacks=_lacks,
    auto=_auto,
    distance="assumed",
    useful_angle=10.0,
    alone=(
        "its depth is the silhouette, rounded, {distance} m away by assumption: sizes are known up to scale, limbs in"
        " front of the body are flat"
    ),
)
