"""Temporal pose smoothing (the paper's TPS) of one frame's heatmaps, weighted by scores.

With scores s and unit-amplitude maps g the blend of a frame with what came before it is

    m_t = (w s_t g_t + (1 - w) S_{t-1} m_{t-1}) / (w s_t + (1 - w) S_{t-1}),  amplitude max(s_t, S_{t-1}),

S_{t-1} and m_{t-1} being the previous frame's own (`pairwise`, the paper's equation where the scores are equal) or the
filter's state (`recurrent`: S_t = w s_t + (1 - w) S_{t-1}, started at the frame `truncation` before, so that the output
depends on those frames only). A stored heatmap is s g, so no division by a score is needed, a missing frame (s_t = 0)
passes the state on at full height, and one missing before leaves the current frame as it is.

Lag behind a joint that moves at constant speed, in frames: 1 - w for pairwise; for recurrent the sum of (1 - w)^k over
k = 1..truncation, which tends to (1 - w) / w. Step response: pairwise is there after 1 frame, recurrent has
1 - (1 - w)^(k + 1) of its mass at the new place k frames after the step, and all of it `truncation` frames after.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.pose.heatmaps import FLOOR


def taps(omega: float, past: int) -> np.ndarray:
    """[past + 1] weights of frames t, t-1, ..., t-past: omega (1 - omega)^k, the oldest takes what is left;
    they sum to 1."""
    decay = (1.0 - omega) ** np.arange(past + 1)
    return np.append(omega * decay[:-1], decay[-1])


def blend(heatmaps: np.ndarray, scores: np.ndarray, omega: np.ndarray, calm: np.ndarray) -> np.ndarray:
    """Blend [n + 1, J, h, w] heatmaps of frames t-n..t with scores [n + 1, J] -> [J, h, w] float32.

    omega: [J] weight of the current frame; calm: [J] in 0..1, how much of the past's larger score the amplitude may
    take on. The past's score is the state's, sum of taps_k s_{t-k} over k >= 1 relative to their sum. Joints with omega
    = 1 and frames without a past are returned as they are; values under 1e-3 are 0, as in every stored heatmap.
    """
    current = heatmaps[-1].astype(np.float32)
    if len(heatmaps) == 1:
        return current
    past = len(heatmaps) - 1
    weights = np.stack([taps(float(w), past) for w in omega], axis=-1)  # [n + 1, J]
    parts = weights * scores[::-1]
    total = parts.sum(axis=0)
    before = parts[1:].sum(axis=0) / np.maximum(1.0 - omega, np.finfo(np.float64).tiny)
    amplitude = scores[-1] + calm * np.maximum(before - scores[-1], 0.0)
    filtered = (omega < 1) & (total > 0)
    gain = np.where(filtered, amplitude / np.where(filtered, total, 1.0), 1.0)
    factors = np.where(filtered, weights * gain, np.eye(past + 1, 1)).astype(np.float32)
    out = np.zeros_like(current)
    for k in range(past + 1):
        out += factors[k][:, None, None] * heatmaps[past - k]
    out[out < FLOOR] = 0
    return np.minimum(out, 1.0)


def stillness(heatmaps: np.ndarray, joints: np.ndarray, limit: float, cell: int) -> np.ndarray:
    """[J] in 0..1: 1 for a joint at rest, 0 from `limit` sigmas of displacement between two frames on.

    heatmaps [2, J, h, w], joints [2, J, 3] (u, v, score) px of frames/*; `cell` px to a heatmap cell. A map's sigma
    follows from its mass, sum = 2 pi s sigma^2; a cut map seems narrower, so the joint faster, which errs towards the
    current frame, and an empty map of a joint that left the picture makes it infinitely fast. A joint that is missing
    in either frame has no speed and counts as at rest.
    """
    rows = heatmaps.reshape(-1, heatmaps.shape[2] * heatmaps.shape[3]).astype(np.float32)
    scores = joints[..., 2].astype(np.float64)
    mass = rows.sum(axis=1).reshape(scores.shape) / np.where(scores > 0, scores, 1.0)
    sigma = cell * np.sqrt(mass / (2 * np.pi)).min(axis=0)
    moved = np.linalg.norm(joints[1, :, :2].astype(np.float64) - joints[0, :, :2], axis=-1)
    reach = limit * sigma
    calm = np.where(moved < reach, 1.0 - moved / np.where(reach > 0, reach, 1.0), 0.0)
    return np.where((scores > 0).all(axis=0), calm, 1.0)
