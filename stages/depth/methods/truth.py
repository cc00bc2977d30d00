"""The simulator's own depth, to tell what depth costs from what the rest of the pipeline does."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.facts import TRUTH_DEPTH, Facts
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.depth.methods.declaration import DepthMethod


def _maps(inputs: Inputs, params: SearchSettings, view: int) -> tuple[np.ndarray, np.ndarray]:
    depth = inputs.read("truth/depth", view)
    return depth, depth > 0


def _lacks(facts: Facts) -> str | None:
    if TRUTH_DEPTH in facts:
        return None
    return "the capture has no true depth for every source view (only simulated captures have); use auto"


METHOD = DepthMethod(
    "truth", "the simulator's depth, a diagnostic", of_view=_maps, reads=("truth/depth",), lacks=_lacks
)
