"""The anchors of BlazePose's person detector: where in its input each of the 2254 answers is counted from.

The parameters are those of MediaPipe's public graph `modules/pose_detection/pose_detection_cpu.pbtxt` (input 224,
strides 8 16 32 32 32, aspect ratio 1 and the interpolated one, offset 0.5, fixed size), so every anchor is a centre,
its size 1.
"""

from __future__ import annotations

from itertools import groupby

import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres

INPUT = 224
"""Side of the detector's input in px."""
STRIDES = (8, 16, 32, 32, 32)
"""Px of the input between the cells of each layer."""
PER_LAYER = 2
"""Anchors a layer puts into each cell: one for the aspect ratio, one for the interpolated scale; they coincide, as
the size is fixed."""


def anchors() -> np.ndarray:
    """[2254, 2] float32 centres (x, y) as shares of the input, in the order of the detector's answers.

    Layers of equal stride share their cells: all their anchors of one cell stand together, cells row by row.
    """
    layers = []
    for stride, same in groupby(STRIDES):
        n = -(-INPUT // stride)
        centres = pixel_centres((n, n)).reshape(-1, 2) / n
        layers.append(np.repeat(centres, PER_LAYER * len(list(same)), axis=0))
    return np.concatenate(layers).astype(np.float32)
