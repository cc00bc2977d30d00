"""An estimator's own heatmaps, from the region it looked at back to the view:
the paper's pose features of real pictures."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.imaging.camera_mapping import captured_positions, switched
from posegaussian.stages.imaging.regions import to_own
from posegaussian.stages.pose.heatmaps import CELL, FLOOR
from posegaussian.stages.pose.left_right_swaps import Sides
from posegaussian.stages.pose.tracking import Followed
from posegaussian.storage.model.cameras import points_to_integer_centres

FAINTEST = 0.05
"""Largest value of a heatmap below which it shows no joint, and a Gaussian is drawn in its place."""


def put_model_maps(inputs: Inputs, maps: np.ndarray, scores: np.ndarray, followed: Followed, view: int) -> None:
    """Replace drawn peaks in maps [F, 17, rows, columns] of one view by the estimator's, where an estimate stands.

    scores [F, 17]: score of a joint whose estimate stands, else 0; `followed` tells which of the people found is the
    subject, and in which parts a joint's map goes under the name of its mirror image. A map is scaled so that its
    largest value is the joint's score, as of drawn ones; values under 1e-3 are 0.
    """
    found, regions = inputs.read("detection/heatmaps", view), inputs.read("detection/region", view)
    rows, columns = maps.shape[2:]
    cells = pixel_centres((columns, rows)) * CELL
    source_rig, crops = switched(inputs.source_rig, inputs.captured_to_calibrated, inputs.facts)
    captured = captured_positions(
        cells, inputs.rig.intrinsics[view], source_rig.intrinsics[view], source_rig.distortion[view], crops[view]
    )
    pictured = np.isfinite(captured).all(axis=-1) & (cells < inputs.rig.size[view]).all(axis=-1)
    captured = np.where(pictured[..., None], captured, -1e6)
    named = Sides.of("coco17").exchange(np.arange(17)[:, None], followed.exchanged[:, view])[..., 0]
    for f, person in enumerate(followed.chosen[:, view]):
        if person < 0 or regions[f, person, 2] <= 0:
            continue
        side = found.shape[-1]
        at = (
            points_to_integer_centres(to_own(captured.reshape(-1, 2), regions[f, person]) * side)
            .astype(np.float32)
            .reshape(rows, columns, 2)
        )
        for j in np.flatnonzero(scores[f] > 0):
            own = np.asarray(found[f, person, named[f, j]], dtype=np.float32)
            if own.max() < FAINTEST:
                continue
            # OpenCV's stubs do not know that the second map may be None
            warped = cv2.remap(own, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)  # type: ignore[call-overload]
            warped = warped * np.float32(scores[f, j] / own.max())
            warped[~pictured | (warped < FLOOR)] = 0
            if warped.any():
                maps[f, j] = warped
