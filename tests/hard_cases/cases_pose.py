"""Records P1-P8: joints, heatmaps and their smoothing over time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from posegaussian.stages.pose.heatmaps import CELL, FLOOR, draw
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.stage import STAGE as POSE
from posegaussian.stages.smoothing.params import SmoothingParams
from posegaussian.storage.model.joint_sets import COCO17
from tests.hard_cases.catalogue import Case, apart, worst
from tests.stages.smoothing.test_smoothing import HALF, METHODS, SIGMA, encode, noisy, smooth, track
from tests.support.memory_inputs import run_stage
from tests.support.walking_skeleton import Joints2D, pixels, ring, roles, walk

SIZE, GRID = (64, 48), (12, 16)
"""(width, height) px, and (rows, columns) of cells."""
CENTRES = CELL * np.arange(16) + CELL / 2
OLD = CELL * np.arange(32) + CELL / 2 < 60
"""Columns of cells where a joint of `jump` was before."""


def joint(u: float, v: float = 22.0, score: float = 1.0, sigma: float = 6.0) -> np.ndarray:
    """[rows, columns] our heatmap of one joint."""
    return draw(np.array([[[u, v, score]]]), np.array([[sigma]]), SIZE, GRID)[0, 0].astype(np.float64)


def bell(u: float, v: float = 22.0, sigma: float = 6.0) -> np.ndarray:
    """[rows, columns] the textbook's heatmap: exp(-d^2 / 2 sigma^2) at the cells' centres."""
    rows, columns = np.meshgrid(CENTRES[:12], CENTRES, indexing="ij")
    return np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * sigma**2))


def naive_place() -> float:
    """Soft-argmax of the heatmap of a joint that nobody saw."""
    empty = np.zeros((12, 16))
    return float((empty * CENTRES).sum() / empty.sum())


def nobody_error() -> float:
    """What smoothing makes of frames without a person, with every method."""
    empty = track([66.0, 66.0, 66.0], [0.0, 0.0, 0.0])
    return worst([apart(smooth(empty, method=m, omega=0.8), 0) for m in METHODS] + [apart(joint(30.0, score=0.0), 0)])


OUTSIDE = [(-0.01, 22.0), (-12.0, 22.0), (70.0, 22.0), (30.0, 48.0), (1e6, 22.0)]


def naive_outside() -> float:
    """A map brought to a peak of 1, as training targets are; far outside there is nothing to divide by, so that one
    is left out here."""
    return worst(float((bell(u, v) / bell(u, v).max()).max()) for u, v in OUTSIDE[:-1])


def border_error() -> float:
    """No mass outside; on the border the Gaussian is cut and keeps its height."""
    return worst([*(joint(u, v).max() for u, v in OUTSIDE), abs(joint(0.0).max() - math.exp(-(2**2) / 72))])


CORNERS = [(30.0, 22.0), (28.01, 20.01), (31.99, 23.99)]
"""A cell's centre, and its corners."""


def naive_narrow() -> float:
    return worst(1 - float(bell(u, v, 0.0).max()) for u, v in CORNERS)


def pairwise_plain(h: np.ndarray, omega: float) -> np.ndarray:
    """The paper's equation for all frames at once: omega h_t + (1 - omega) h_{t-1}."""
    return omega * h + (1 - omega) * np.roll(h, 1, axis=0)


def naive_first() -> float:
    """At the first frame the index -1 is the last frame."""
    h = noisy()["pose/heatmaps"].astype(np.float64)
    return apart(pairwise_plain(h, 0.8)[0], h[0])


def first_error() -> float:
    """The first frame passes, in partitions of any length, and omega 1 passes everything."""
    arrays = noisy()
    h = arrays["pose/heatmaps"]
    found = [apart(smooth(arrays, method=m, omega=0.3)[0], h[0]) for m in METHODS]
    found += [apart(smooth(arrays, method=m, omega=1.0), h) for m in METHODS]
    return worst(
        found
        + [
            apart(
                smooth(arrays, length, method=m, omega=0.3, truncation=3),
                smooth(arrays, method=m, omega=0.3, truncation=3),
            )
            for m in METHODS
            for length in (1, 2)
        ]
    )


def swapped() -> dict[str, np.ndarray]:
    """Two frames in which left and right change places, 50 px apart."""
    joints = np.tile(np.array([40.0, 66.0, 1.0]), (2, 1, 17, 1))
    joints[0, 0, 1::2, 0] = joints[1, 0, 0::2, 0] = 90.0
    return encode(joints)


def twin(heatmaps: np.ndarray) -> float:
    """Height, in the second frame, of what is where a joint is not: farther than four sigmas."""
    across = CELL * np.arange(32) + CELL / 2
    places = np.where(np.arange(17) % 2 == 0, 90.0, 40.0)
    elsewhere = np.abs(across[None] - places[:, None]) > 4 * SIGMA
    return float((heatmaps[1, 0].astype(np.float64) * elsewhere[:, None, :]).max())


def filmed(fault: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """[9, 17, 3] joints of somebody who walks, and what the pose stage makes of them seen by six cameras after a
    `fault` of the detector."""
    cameras, points = ring(6, size=96), walk(9)
    given = fault(pixels(cameras, points))
    return points, run_stage(
        POSE,
        PoseParams(),
        {},
        cameras,
        roles(cameras),
        9,
        sources={"joints": Joints2D.single(given)},
        facts=frozenset({"joints2d"}),
    )


def turned_round(joints: np.ndarray) -> np.ndarray:
    """Left for right in one frame of all views, and in one more of two views."""
    flips, out = list(COCO17.flips), joints.copy()
    out[4], out[6, :2] = joints[4][:, flips], joints[6, :2][:, flips]
    return out


def mended_error() -> float:
    """By how much smoothed heatmaps, of any method, differ from those of a detector without the fault."""
    (_, right), (_, put_right) = filmed(lambda joints: joints), filmed(turned_round)
    return worst(apart(smooth(put_right, method=m, omega=0.5), smooth(right, method=m, omega=0.5)) for m in METHODS)


def twin_error() -> float:
    """The pose stage leaves no twin to any method; of joints it cannot put right, `adaptive` makes none."""
    return worst([mended_error(), twin(smooth(swapped(), method="adaptive", omega=0.5))])


HIDDEN = slice(3, 6)
"""Frames in which five of six views miss the left wrist."""


def behind(joints: np.ndarray) -> np.ndarray:
    out = joints.copy()
    out[HIDDEN, 1:, 9] = 0
    return out


def naive_hidden() -> float:
    """Millimetres: the joint is left where it was seen last."""
    points = walk(9)
    return 1000 * worst(np.linalg.norm(points[HIDDEN, 9] - points[HIDDEN.start - 1, 9], axis=-1))


def hidden_error() -> float:
    """Millimetres of the bridged joint."""
    points, found = filmed(behind)
    joint = found["pose/joints3d"][HIDDEN, 9]
    return 1000 * worst(np.where(joint[:, 3] > 0, np.linalg.norm(joint[:, :3] - points[HIDDEN, 9], axis=-1), np.nan))


WEIGHT = 0.2
"""Of the current frame, where lag is measured: strong smoothing."""


def jump() -> dict[str, np.ndarray]:
    return track([30.0] * 3 + [98.0] * 40)


def frames_shown(heatmaps: np.ndarray) -> float:
    """Frames after the jump in which the old place still shows."""
    return float((heatmaps[3:, 0, 0][:, :, OLD].max(axis=(1, 2)) >= FLOOR).sum())


def naive_average() -> float:
    """An exponential average over all that was."""
    h = jump()["pose/heatmaps"].astype(np.float64)
    out = h.copy()
    for t in range(1, len(h)):
        out[t] = WEIGHT * h[t] + (1 - WEIGHT) * out[t - 1]
    return frames_shown(out)


def longest() -> float:
    """The same of every method as it is set by default."""
    return worst(frames_shown(smooth(jump(), method=m, omega=WEIGHT)) for m in METHODS)


GAP = (0.8, 0.0, 0.8, 0.8)
"""Scores of a joint that is missed in one frame."""


def peak_error(heatmaps: np.ndarray) -> float:
    """Of a joint at rest whose score is 0.8."""
    return apart(heatmaps.astype(np.float64).max(axis=(2, 3, 4))[:, 0], 0.8)


CASES = (
    Case(
        "P1",
        "nobody in the picture",
        "the mean place of an empty heatmap is 0 / 0",
        "of a peak",
        naive_place,
        nobody_error,
        0.0,
        "an unknown joint has score 0 and an empty map, which nothing is divided by",
    ),
    Case(
        "P2",
        "a joint on the border or outside",
        "brought to a peak of 1, a joint outside stands on the border",
        "of a peak",
        naive_outside,
        border_error,
        5e-4,
        "no mass outside, cut and not renormalised on the border; float16",
    ),
    Case(
        "P3",
        "sigma 0",
        "0 / 0 on a cell's centre, nothing anywhere else",
        "of a peak",
        naive_narrow,
        lambda: worst(1 - joint(u, v, sigma=0.0).max() for u, v in CORNERS),
        1 - math.exp(-1.01),
        "drawn at least half a cell wide; a corner of a cell is 1.41 of these off its centre",
    ),
    Case(
        "P4",
        "the first frame, the first of a partition",
        "the frame before the first is the last",
        "of a peak",
        naive_first,
        first_error,
        0.0,
        "the first frame passes as it is; partitions read what lies before them",
    ),
    Case(
        "P5",
        "left and right change places between frames, or views",
        "the blend shows a twin at half height",
        "of a peak",
        lambda: twin(pairwise_plain(swapped()["pose/heatmaps"].astype(np.float64), 0.5)),
        twin_error,
        FLOOR + HALF,
        "what other views and frames tell is put right before any filter; of what they do not, `adaptive` blends"
        " nothing that moved by more than its sigma",
    ),
    Case(
        "P6",
        "a jump",
        "an average over all frames shows the old place for many",
        "frames",
        naive_average,
        longest,
        float(SmoothingParams().truncation),
        "none for `adaptive`, 1 for `pairwise`, `truncation` for `recurrent`",
    ),
    Case(
        "P7",
        "a joint that is missed in one frame",
        "its peak falls to 1 - omega",
        "of a peak",
        lambda: peak_error(pairwise_plain(track([66.0] * 4, list(GAP))["pose/heatmaps"].astype(np.float64), 0.8)),
        lambda: worst(peak_error(smooth(track([66.0] * 4, list(GAP)), method=m, omega=0.8)) for m in METHODS),
        1e-3,
        "weighted by scores; float16",
    ),
    Case(
        "P8",
        "a joint that one view alone sees for some frames",
        "left where it was, it trails behind the body",
        "mm",
        naive_hidden,
        hidden_error,
        1.0,
        "between the frames before and after, hung on its limb and moved onto the one view's ray; float32",
    ),
)
