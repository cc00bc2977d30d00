"""What an example starts from: analytic depth, the hull, the truth, with noise or without, or a relief."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import cv2
import numpy as np

from posegaussian.stages.depth.algorithms.relief import relief
from posegaussian.stages.matching.fuse import MATCHED
from posegaussian.stages.training.config import Starts

Kind = Literal["matched", "hull", "noisy", "truth"]
OFF = (0.3, 8.0)
"""Px of disparity, least and largest standard deviation of noise in patches; drawn evenly in its logarithm."""
PATCH = (8, 96)
"""Px, smallest and largest side of such a patch."""
TOLD = 0.5
"""Share of the noisy starts whose confidence knows where they are off, as a matcher's does."""


class Start(NamedTuple):
    """Of one view."""

    depth: np.ndarray
    """[h, w] float32 metres, 0 where there is no surface."""
    confidence: np.ndarray
    """[h, w] float32 0..1."""


def kind_drawn(starts: Starts, random: np.random.Generator) -> Kind:
    """A kind, by its share."""
    shares = np.cumsum([starts.matched, starts.hull, starts.noisy, starts.truth])
    kinds: tuple[Kind, ...] = ("matched", "hull", "noisy", "truth")
    return kinds[int(np.searchsorted(shares, random.random() * shares[-1], side="right"))]


def start_of(
    frame: Mapping[str, np.ndarray], view: int, kind: Kind, sensitivity: float, random: np.random.Generator
) -> Start:
    """The start of a view of a frame. `sensitivity`: px of disparity per 1/metre, what noise is measured by."""
    matched = Start(frame["depth"][view], frame["confidence"][view].astype(np.float32))
    if kind == "matched":
        return matched
    if kind == "hull":
        near = frame["hull"][view]
        return Start(near, np.where(near > 0, np.float32(MATCHED), np.float32(0)))
    truth = frame["truth"][view]
    there = (truth > 0) & (matched.depth > 0)
    if kind == "truth":
        sure = np.float32(random.uniform(MATCHED, 1.0))
        return Start(np.where(there, truth, matched.depth), np.where(there, sure, matched.confidence))
    noise = patches(truth.shape, random) * np.float32(np.exp(random.uniform(*np.log(OFF))))
    depth = off_by(truth, noise / sensitivity)
    known = np.exp(-np.abs(noise) / 2) if random.random() < TOLD else np.full_like(noise, random.uniform(0.3, 1.0))
    return Start(np.where(there, depth, matched.depth), np.where(there, known, matched.confidence))


def off_by(depth: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Depth [h, w], metres, whose inverse is changed by [h, w], 1/m, at most by a fifth of itself; 0 stays 0."""
    known = depth > 0
    now = 1 / np.where(known, depth, 1)
    return np.where(known, 1 / (now + np.clip(inverse, -0.2 * now, 0.2 * now)), 0).astype(np.float32)


def patches(shape: tuple[int, ...], random: np.random.Generator) -> np.ndarray:
    """[h, w] float32 smooth noise of standard deviation 1 or a little less, over patches of one random size."""
    height, width = shape
    side = float(np.exp(random.uniform(*np.log(PATCH))))
    coarse = random.standard_normal((int(height / side) + 2, int(width / side) + 2)).astype(np.float32)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def relief_start(mask: np.ndarray, truth: np.ndarray, focal: float) -> Start:
    """The relief of a view's mask [h, w] at the distance at which its mean inverse depth is the truth's.

    How far away a single view's subject is nobody can know: what is asked is the shape.
    """
    depth, confidence = relief(mask, 1.0, focal)
    both = (depth > 0) & (truth > 0)
    scale = float((1 / depth[both]).mean() / (1 / truth[both]).mean()) if both.any() else 1.0
    return Start((scale * depth).astype(np.float32), confidence)
