"""Which source views make a picture, and how strongly: nearest in angle first, fading out before they are replaced; and
how much of it the refined Gaussians of all views are."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.facts import Facts, fact
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.network.params import TWISTED, depth_array

REFINEMENT = fact("refinement")
"""Name of the refinement stage, and the fact that it is needed."""
OF_GAUSSIANS = ("gaussians/scale", "gaussians/rotation", "gaussians/opacity")
"""Beside picture and depth, what the Gaussians of a view are lifted from."""
TWIST = "gaussians/twist"
"""And this, where weights say whole rotations."""
REFINED = (
    "refinement/color",
    "refinement/depth",
    "refinement/scale",
    "refinement/rotation",
    "refinement/opacity",
    "refinement/twist",
    "refinement/shift",
    "refinement/pixel",
)
"""What they are lifted from after refinement, which turns and shifts all of them: lists, not maps."""
COUNTS = "refinement/count"
"""[F, V] how many entries of the lists are used."""
OUTCOME = "refinement/outcome"
"""[F, 8] how each frame's refinement went; the last number is the refined picture's share."""
NEAR = 0.1
"""Share of the way from one camera to the next within which the refined picture fades in. At a source camera its own
Gaussians draw its own picture, 35 dB where the mean of both has 32; from a tenth of the way on, where what that camera
does not see shows, the mean is better (`python -m benchmarks.refinement.near`)."""

CLOSE = (30.0, 36.0)
"""Degrees between the two nearest source cameras up to which outlines are the refined picture's, and from which on they
are mixed as all else. Refined Gaussians know outlines from all sides, but only where cameras stand close do these tell
what lies between: thirteen tuning people filmed from 15 to 30 degrees apart (384 px) gain 0.19 dB on the mean, none of
them less than 0.01, two from 36 apart 0.03, and nine from 35 to 60 apart lose as often as they gain (-0.31 to 0.29)."""
TRUSTED = (0.55, 0.65)
"""The refined picture's share up to which outlines are mixed and as soft as drawn, and from which on they are the
refined picture's and as sharp as the masks'. `bust`, whose cameras stand 31 to 42 degrees apart and whose masks do not
fit each other, has 0.53, and would lose 0.6 dB by the first and 0.1 by the second."""


def unrefined_arrays(facts: Facts) -> tuple[str, ...]:
    """What the Gaussians of a view are lifted from before refinement, in the order
    `posegaussian.stages.rendering.lift.GaussianMaps` takes it."""
    return ("frames/color", depth_array(facts), *OF_GAUSSIANS, *((TWIST,) if TWISTED in facts else ()))


def map_bytes(pixels: int, views: int) -> int:
    """What a frame's maps before refinement and its masks take, of so many views of so many pixels each."""
    return pixels * views * 28


def map_arrays(facts: Facts) -> tuple[str, ...]:
    """The arrays that the Gaussians of a view are lifted from: the refined ones where the refinement stage is on."""
    return REFINED if REFINEMENT in facts else unrefined_arrays(facts)


def refined_shares(inputs: Inputs) -> np.ndarray:
    """[F] share 0..1 of the refined Gaussians' picture in those of each frame of the partition; the rest is drawn as
    without refinement."""
    if REFINEMENT not in inputs.facts:
        return np.zeros(len(inputs.partition))
    return np.asarray(inputs.read(OUTCOME), np.float64)[:, -1]


def angles_at(subject: np.ndarray, centres: np.ndarray, target: np.ndarray) -> np.ndarray:
    """[V] angle in radians at the subject [3] between each camera centre [V, 3]
    and the target's centre [3], world metres."""
    rays, ray = centres - subject, target - subject
    across = np.linalg.norm(np.cross(rays, ray), axis=1)
    return np.arctan2(across, rays @ ray)


def choose(angles: np.ndarray, usable: np.ndarray, count: int) -> list[tuple[int, float]]:
    """(view, weight 0..1) of at most `count` usable views, nearest first, equal angles by index.

    angles [V] rad, usable [V] bool. weight = sqrt(1 - angle / `_reach`), divided by the largest: a view has faded to
    nothing when another takes its place, and where another camera stands, so that a moving camera sees no jump.
    Measured on true depth (45 degree ring, a tenth of the way from one source to the next): box PSNR 33.9 dB against
    33.1 with equal weights and 32.4 with the nearest view alone.
    """
    order, limit = [int(v) for v in np.argsort(angles, kind="stable") if usable[v]], _reach(angles, usable, count)
    weights = [np.sqrt(max(0.0, 1 - float(angles[v]) / limit)) if limit > 0 else 0.0 for v in order[:count]]
    largest = max(weights, default=0.0)
    return [
        (v, float(w / largest) if largest > 0 else 1.0)
        for v, w in zip(order, weights, strict=False)
        if w > 0 or largest == 0
    ]


def _reach(angles: np.ndarray, usable: np.ndarray, count: int) -> float:
    """Angle in radians at which a view has no say any more: that of the nearest of the usable views that is not among
    the `count` nearest, but no more than in a ring of even gaps, where it is twice the nearest view's and once the
    second's. Without that bound a neighbour far away covers what a source camera sees itself."""
    found = np.sort(angles[usable], kind="stable")
    left_out = float(found[count]) if len(found) > count else float(np.pi)
    return min(left_out, float(2 * found[0] + found[1])) if count > 1 and len(found) > 1 else left_out


def faded_in(angles: np.ndarray) -> float:
    """How far the refined picture has faded in, 0 at a source camera to 1; `angles` [V] rad of the target from the
    usable views, at the subject. Continuous as the target moves."""
    nearest = np.sort(angles)[:2]
    between = float(nearest.sum())
    return min(1.0, float(nearest[0]) / between / NEAR) if len(nearest) == 2 and between > 0 else 1.0


def outlines_trusted(angles: np.ndarray, share: float) -> float:
    """How far outlines of a picture with a refined `share` of 0..1 are where they belong, as left-out views say, 0..1;
    `angles` [V] rad of the target from the usable views, at the subject. 0 at a source camera, and continuous as the
    target moves."""
    return float(np.interp(share, TRUSTED, (0, 1))) * faded_in(angles)


def outlines_refined(angles: np.ndarray, share: float) -> float:
    """How far outlines are the refined picture's alone, 0..1; see `outlines_trusted`."""
    apart = float(np.degrees(np.sort(angles)[:2].sum()))
    return float(np.interp(apart, CLOSE, (1, 0))) * outlines_trusted(angles, share) if len(angles) > 1 else 0.0
