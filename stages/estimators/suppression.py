"""Weighted non-maximum suppression: of many overlapping answers one detection each, averaged by their scores."""

from __future__ import annotations

import numpy as np


def overlap(box: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """[N] intersection over union of a box [4] with boxes [N, 4], each (x0, y0, x1, y1); 0 where both are empty."""
    low = np.maximum(box[:2], boxes[:, :2])
    high = np.minimum(box[2:], boxes[:, 2:])
    common = np.prod(np.maximum(high - low, 0), axis=1)
    union = np.prod(box[2:] - box[:2]) + np.prod(boxes[:, 2:] - boxes[:, :2], axis=1) - common
    return np.divide(common, union, out=np.zeros_like(common), where=union > 0)


def weighted_suppression(
    boxes: np.ndarray, points: np.ndarray, scores: np.ndarray, threshold: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Detections of boxes [N, 4], key points [N, K, 2] and scores [N]: the same of M <= N, by falling score.

    The best answer left takes all that overlap its box by more than `threshold`; box and points are their mean
    weighted by score, and the score stays the best one's. Equal scores keep their order. The algorithm is the one
    MediaPipe's graph asks for (NonMaxSuppressionCalculator, WEIGHTED).
    """
    left = np.argsort(-scores, kind="stable")
    kept_boxes, kept_points, kept_scores = [], [], []
    while len(left):
        best = left[0]
        near = overlap(boxes[best], boxes[left]) > threshold
        near[0] = True
        group = left[near]
        weight = scores[group] / scores[group].sum()
        kept_boxes.append(weight @ boxes[group])
        kept_points.append(np.tensordot(weight, points[group], 1))
        kept_scores.append(scores[best])
        left = left[~near]
    return (
        np.array(kept_boxes).reshape(-1, 4),
        np.array(kept_points).reshape(-1, *points.shape[1:]),
        np.array(kept_scores),
    )
