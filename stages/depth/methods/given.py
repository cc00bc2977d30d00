"""Depth maps that came with the capture."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.facts import GIVEN_DEPTH, SINGLE_SOURCE, Facts
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.depth.methods.declaration import DepthMethod


def _maps(inputs: Inputs, params: SearchSettings, view: int) -> tuple[np.ndarray, np.ndarray]:
    from posegaussian.stages.depth.algorithms.given_depth import given_depth

    focal = float(inputs.rig.intrinsics[view, 0, 0])
    found = [given_depth(z, focal, params.depth_range) for z in inputs.read("frames/depth", view)]
    return np.stack([z for z, _ in found]), np.stack([c for _, c in found])


def _lacks(facts: Facts) -> str | None:
    if GIVEN_DEPTH in facts:
        return None
    return (
        "not every source view has depth maps (layout images: depth_maps/CAMERA/000000.exr); import them, leave the"
        " others out of views.sources, or use auto"
    )


def _auto(facts: Facts) -> str | None:
    if GIVEN_DEPTH not in facts:
        return None
    return "the capture came with depth maps of every source view" + (
        "" if SINGLE_SOURCE in facts else "; depth.method: sgbm would match the views instead"
    )


METHOD = DepthMethod(
    "given",
    "depth maps that came with the capture",
    of_view=_maps,
    reads=("frames/depth",),
    lacks=_lacks,
    auto=_auto,
    distance="measured",
    alone="its depth is that of the maps given",
)
