"""BlazePose's raw outputs read: detections from answers at anchors, landmarks from logits, and landmarks refined by
their heatmaps.

The constants are those of MediaPipe's public graphs (`modules/pose_detection/pose_detection_cpu.pbtxt`,
`modules/pose_landmark/tensors_to_pose_landmarks_and_segmentation.pbtxt`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.estimators.anchors import INPUT
from posegaussian.stages.estimators.suppression import weighted_suppression

SCORE_CLIP = 100.0
"""Logits of the detector are cut to this size, so that the sigmoid cannot overflow."""
OVERLAP = 0.3
"""Intersection over union of two face boxes above which they are one person."""
LANDMARKS = 39
"""Landmarks the model gives: 33 of the body, the centre and rim of its region (33, 34), and four more for the hands."""
CROP = 256
"""Side of the landmark model's input in px."""
REFINING_KERNEL = 7
"""Cells along a side of the neighbourhood a landmark is refined in."""
REFINING_CONFIDENCE = 0.5
"""Largest heatmap value of the neighbourhood from which a landmark is refined."""


def sigmoid(x: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-x)) without overflow, float32."""
    return np.float32(0.5) * (np.float32(1) + np.tanh(np.float32(0.5) * x, dtype=np.float32))


@dataclass(frozen=True, eq=False)
class BoxDetections:
    """D people, by falling score, in shares 0..1 of the detector's square input."""

    boxes: np.ndarray
    """[D, 4] (x0, y0, x1, y1) box of the face."""
    points: np.ndarray
    """[D, 4, 2] centre of the hips, a point on the circle around the whole body, centre of the shoulders, a point on
    the circle around the upper body."""
    scores: np.ndarray
    """[D] 0..1."""


def detections(raw: np.ndarray, logits: np.ndarray, anchors: np.ndarray, least: float) -> BoxDetections:
    """People from the detector's answers [N, 12] (x, y, w, h, 4 x (x, y), px of the input from the anchor), logits
    [N] and anchors [N, 2]."""
    scores = sigmoid(np.clip(logits, -SCORE_CLIP, SCORE_CLIP))
    good = np.flatnonzero(scores >= least)
    values = raw[good].astype(np.float64) / INPUT
    centre = values[:, :2] + anchors[good]
    half = values[:, 2:4] / 2
    boxes = np.concatenate([centre - half, centre + half], axis=1)
    points = values[:, 4:].reshape(-1, 4, 2) + anchors[good][:, None]
    return BoxDetections(*weighted_suppression(boxes, points, scores[good].astype(np.float64), OVERLAP))


def landmarks(raw: np.ndarray, heatmaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places [39, 2] in the region's own coordinates and scores [39], from the model's 195 numbers and its heatmaps
    [64, 64, 39] (0..1).

    A score is visibility x presence of the landmark, each the sigmoid of the model's logit.
    """
    values = raw.reshape(LANDMARKS, 5)
    places = refined(values[:, :2].astype(np.float64) / CROP, heatmaps)
    return places, sigmoid(values[:, 3]) * sigmoid(values[:, 4])


def refined(places: np.ndarray, heatmaps: np.ndarray) -> np.ndarray:
    """Places [J, 2] (0..1) moved to the mean of their heatmaps [h, w, J] over the 7 x 7 cells around them.

    Cell (i, j) stands at (j/w, i/h), see `centred`. A landmark outside the region, or whose neighbourhood stays below
    0.5, keeps its place. After MediaPipe's RefineLandmarksFromHeatmapCalculator.
    """
    h, w, _ = heatmaps.shape
    reach = REFINING_KERNEL // 2
    out = np.array(places, dtype=np.float64)
    for j, (x, y) in enumerate(places):
        col, row = int(np.floor(x * w)), int(np.floor(y * h))
        if not (0 <= col < w and 0 <= row < h):
            continue
        rows, cols = (
            np.arange(max(0, row - reach), min(h, row + reach + 1)),
            np.arange(max(0, col - reach), min(w, col + reach + 1)),
        )
        part = heatmaps[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1, j].astype(np.float64)
        if part.max() >= REFINING_CONFIDENCE:
            out[j] = part.sum(0) @ cols / part.sum() / w, part.sum(1) @ rows / part.sum() / h
    return out


def centred(heatmaps: np.ndarray) -> np.ndarray:
    """Heatmaps [h, w, J] whose cell (i, j) stands at (j/w, i/h) -> the same at the cells' centres, ((j + .5)/w, (i +
    .5)/h).

    BlazePose's maps are of the first kind: over mirrored crops of real people the columns of a peak and of its mirror
    image add up to 64.0, not 63. Half a cell is interpolated cubically, as a mean of neighbours would lower the peaks.
    """
    out = heatmaps
    for axis in (0, 1):
        n = out.shape[axis]
        padded = np.pad(out, [(1, 2) if a == axis else (0, 0) for a in range(3)])
        a, b, c, d = (np.take(padded, np.arange(k, k + n), axis) for k in range(4))
        out = (9 * (b + c) - (a + d)) / 16
    return np.clip(out, 0, 1)
