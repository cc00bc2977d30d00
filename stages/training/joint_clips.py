"""Joints of a short clip as estimators give them, and the heatmaps they come to: of the frame alone, and stabilised.

An estimator's error does not start anew in every frame: it drifts, misses a joint for a while, takes left for right,
loses a limb behind the body. What looks like this is what the stabiliser is for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posegaussian.stages.pose.heatmaps import CELL, draw
from posegaussian.stages.smoothing.params import SmoothingParams
from posegaussian.stages.smoothing.run import stabilised
from posegaussian.stages.training.config import Stabiliser
from posegaussian.storage.model.joint_sets import COCO17

WITHOUT = 0.1
"""Share of the examples without any joints, as captures without an estimator have it."""
NOISE = 3.0
"""Px, largest standard deviation of what joints are moved by; twice that where a joint is hidden."""
DRIFT = 0.9
"""Largest share of a joint's error that it keeps from one frame to the next."""
MISSED = 0.2
"""Largest share of the joints that are not found."""
LASTING = 0.5
"""Share of those that are missed in all frames of the clip."""
ELSEWHERE, FAR = 0.01, 10.0
"""Share of the joints that are found elsewhere, and how many times as far off."""
TURNED = 0.1
"""Share of the examples in which left and right are exchanged, of the arms, the legs or all, in half of the frames."""
LIMB = 0.2
"""Share of the examples that lack a forearm or a lower leg."""
SIGMAS = (5.0, 10.0)
"""Px, narrowest and broadest heatmap of a joint.
The pose stage's 4 cm are about 10 px at the size of a person in these pictures."""
ARMS, LEGS = (5, 6, 7, 8, 9, 10), (11, 12, 13, 14, 15, 16)
ENDS = ((7, 9), (8, 10), (13, 15), (14, 16))
"""Elbow and wrist, knee and ankle, left and right, in COCO-17."""


class Marks(NamedTuple):
    """How the joints of an example are found and drawn; the same in all of its views."""

    none: bool
    """Whether there are none."""
    noise: float
    """Px, standard deviation."""
    drift: float
    """Share of the error kept from frame to frame."""
    missed: float
    """Share that is not found."""
    sigma: float
    """Px of the heatmaps."""
    stabiliser: Stabiliser


EXACT = Marks(False, 0.0, 0.0, 0.0, SIGMAS[1], "none")
"""Nothing is wrong, and nothing is stabilised."""


def marks_drawn(stabilisers: tuple[Stabiliser, ...], random: np.random.Generator) -> Marks:
    """How bad an estimator is, and how its heatmaps are stabilised."""
    none = bool(random.random() < WITHOUT)
    noise, drift, missed = random.uniform(0, NOISE), random.uniform(0, DRIFT), random.uniform(0, MISSED)
    sigma, kind = random.uniform(*SIGMAS), stabilisers[int(random.integers(len(stabilisers)))]
    return Marks(none, float(noise), float(drift), float(missed), float(sigma), kind)


def found(joints: np.ndarray, marks: Marks, random: np.random.Generator | None) -> np.ndarray:
    """Joints [F, 17, 3] (u, v, 1 where seen) px of a view as an estimator gives them, with scores.

    None for the generator: exactly, with scores of 1.
    """
    out = joints.copy()
    out[..., 2] = 0.0 if marks.none else 1.0
    if random is None or marks.none:
        return out
    frames, count = joints.shape[:2]
    seen = joints[..., 2] > 0
    off = random.standard_normal((frames, count, 2))
    for f in range(1, frames):
        off[f] = marks.drift * off[f - 1] + np.sqrt(1 - marks.drift**2) * off[f]
    far = np.where(random.random((frames, count)) < ELSEWHERE, FAR, 1.0)
    out[..., :2] += off * (marks.noise * np.where(seen, 1.0, 2.0) * far)[..., None]
    out[..., 2] = np.where(seen, 0.9, 0.55) + 0.1 * random.random((frames, count))
    lasting, fate = random.random(count) < LASTING, random.random((frames, count))
    out[np.where(lasting, fate[:1], fate) < marks.missed, 2] = 0.0
    if random.random() < TURNED:
        part = (ARMS, LEGS, tuple(range(count)))[int(random.integers(3))]
        turned = np.flatnonzero(random.random(frames) < 0.5)
        ours = np.array(part)
        out[np.ix_(turned, ours)] = out[np.ix_(turned, np.array(COCO17.flips)[ours])]
    if random.random() < LIMB:
        hidden = list(ENDS[int(random.integers(len(ENDS)))])
        out[:, hidden, 2] *= 0.3 if random.random() < 0.5 else 0.0
    return out


def heatmaps_of(joints: np.ndarray, size: tuple[int, int], marks: Marks) -> tuple[np.ndarray, np.ndarray]:
    """Heatmaps [17, h / 4, w / 4] float32 of the clip's last frame, alone and stabilised by the smoothing stage's
    filter, of joints [F, 17, 3] in px of a window of `size` (width, height)."""
    width, height = size
    drawn = draw(joints, np.full(joints.shape[:2], marks.sigma), (width, height), (height // CELL, width // CELL))
    alone = drawn[-1].astype(np.float32)
    if marks.stabiliser == "none":
        return alone, alone
    params = SmoothingParams(method=marks.stabiliser)
    past = params.truncation if params.method == "recurrent" else 1
    return alone, stabilised(drawn[-past - 1 :], joints[-past - 1 :], params)
