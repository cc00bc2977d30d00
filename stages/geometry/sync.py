"""Constant time offsets between the cameras of a rig, from 2D joints alone.

A joint that two cameras see at the same moment lies on each other's epipolar lines. Of two cameras that are out of step
it lies beside them as far as it moves meanwhile. So for every pair of cameras the tracks are compared at every whole
shift; the robust mean square of the epipolar distance has its least where the pair is in step. Between whole shifts the
place of the least follows from the parabola through three of them: the tracks' noise raises all whole shifts alike and
drops out, whereas interpolated tracks are less noisy between the frames and would pull the least there. What is
constant over time is taken out joint by joint and pair by pair: an error of the calibration, or of what a detector
calls a hip. Pairs are combined by least squares.

The error is a jackknife over blocks of time, because joints' errors last for many frames. Of a subject that stands
still, or moves along the epipolar lines only, nothing can be told: the cost is as low at any other shift, and that is
said instead of a number.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from posegaussian.stages.geometry.epipolar import fundamental, homogeneous, signed_epipolar_distance
from posegaussian.storage.model.cameras import Rig

FURTHEST = 20
"""Frames by which two cameras may differ, at most; and never more than a third of the tracks."""
BLOCKS = 16
"""Parts of the time that are left out in turn."""
FEWEST = 8
"""Frames, joint by joint, that two cameras must share at a shift."""
OUTLIER = 3.0
"""Standard deviations beyond which a distance counts as an outlier and costs no more."""
DEEP = 5.5
"""Standard errors by which the least must lie below the mean cost of all shifts: of sixteen blocks, one in 30 000 by
chance at one shift, and the least of some forty was chosen."""
SURE = 0.25
"""Frames of standard error up to which an offset is told: whole frames can be told apart at twice that."""


@dataclass(frozen=True, eq=False)
class TimeOffsets:
    """How far V cameras are out of step."""

    frames: np.ndarray
    """[V] frames by which a camera is late: its picture n + frames shows what the reference's picture n shows; 0
    where not told."""
    error: np.ndarray
    """[V] standard error, frames; 0 for the reference and where not told."""
    told: np.ndarray
    """[V] bool: whether the offset is proven by the motion."""
    reference: int
    """The camera whose offset is 0: the one in the middle."""
    motion: np.ndarray
    """[V] px a frame across the epipolar lines, root mean square: what could tell an offset."""

    def sentence(self, view: int, name: str) -> str:
        """What is known of one camera."""
        if not self.told[view]:
            return (
                f"{name}: cannot be told, its joints move {self.motion[view]:.2f} px a frame across the epipolar lines,"
                " which is too little for their noise or for the frames there are"
            )
        if view == self.reference:
            return f"{name}: the others are compared with it"
        return f"{name}: {self.frames[view]:+.2f} frames, +- {self.error[view]:.2f}"


def time_offsets(rig: Rig, tracks: np.ndarray) -> TimeOffsets:
    """Offsets of the cameras from tracks [F, V, J, 3] (u, v, score) of consecutive frames, px of `rig` without lens;
    score 0 = unknown.

    Joints of one subject; score above 0 counts as known. A camera is told where the mean cost of all shifts lies `DEEP`
    standard errors above the least of its pairs, and the offset's standard error is at most `SURE` frames. Offsets that
    change are not looked for.
    """
    count, views = tracks.shape[:2]
    most = min(FURTHEST, count // 3)
    pairs = list(combinations(range(views), 2)) if most >= 1 else []
    compared = {p: c for p in pairs if (c := _costs(rig, tracks, *p, most)) is not None}
    pairs, motion = list(compared), np.zeros(views)
    sums = np.array(list(compared.values())).reshape(len(pairs), BLOCKS, 2 * most + 1, 2)
    for a, b in pairs:
        step = _motion(rig, tracks, a, b)
        motion[[a, b]] = np.maximum(motion[[a, b]], step)
    nothing = TimeOffsets(np.zeros(views), np.zeros(views), np.zeros(views, bool), 0, motion)
    if not pairs:
        return nothing
    whole = _whole(pairs, _mean(sums), views, most)
    found, depth = _refined(pairs, _mean(sums), whole, most)
    parts = [_refined(pairs, _mean(np.delete(sums, k, axis=1)), whole, most) for k in range(BLOCKS)]
    factor = (BLOCKS - 1) / BLOCKS
    spread = np.sqrt(factor * ((np.array([d for _, d in parts]) - depth) ** 2).sum(axis=0))
    proven = (depth > 0) & (depth >= DEEP * spread)
    if proven.sum() < 2:
        return nothing
    reference = _middle(found, proven)
    shifted = np.array([f - f[reference] for f, _ in parts])
    error = np.sqrt(factor * ((shifted - (found - found[reference])) ** 2).sum(axis=0))
    told = proven & (error <= SURE)
    if told.sum() < 2:
        return nothing
    return TimeOffsets(
        np.where(told, found - found[reference], 0.0), np.where(told, error, 0.0), told, reference, motion
    )


def _middle(offsets: np.ndarray, known: np.ndarray) -> int:
    """The known camera nearest to the median of the known offsets, to a tenth of a frame; the first of equals."""
    far = np.round(np.abs(offsets - np.median(offsets[known])), 1)
    return int(np.where(known, far, np.inf).argmin())


def _aligned(tracks: np.ndarray, a: int, b: int, shift: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tracks of camera a [n, J, 2] and of camera b `shift` frames later, and where both are known [n, J]."""
    start, stop = max(0, -shift), min(len(tracks), len(tracks) - shift)
    first, second = tracks[start:stop, a], tracks[start + shift : stop + shift, b]
    return first[..., :2], second[..., :2], (first[..., 2] > 0) & (second[..., 2] > 0)


def _distances(rig: Rig, tracks: np.ndarray, a: int, b: int, shift: int) -> tuple[np.ndarray, np.ndarray]:
    """Epipolar distances [n, J] px at a shift less each joint's median over time, and which are known; a joint seen
    in few frames is not."""
    first, second, known = _aligned(tracks, a, b, shift)
    known = known & (known.sum(axis=0) >= FEWEST)
    off = np.where(known, signed_epipolar_distance(fundamental(rig, a, b), first, second), np.nan)
    middle = [np.nanmedian(off[:, j]) if known[:, j].any() else 0.0 for j in range(off.shape[1])]
    return np.where(known, off - np.array(middle), 0.0), known


def _costs(rig: Rig, tracks: np.ndarray, a: int, b: int, most: int) -> np.ndarray | None:
    """[BLOCKS, 2 most + 1, 2] sum of costs and count of distances by block of time and shift; None where too little
    is shared at a shift."""
    found = [_distances(rig, tracks, a, b, s) for s in range(-most, most + 1)]
    if not all(k.any() for _, k in found):
        return None
    # Distances of the shift that fits best and of its neighbours are no outliers:
    # the parabola is laid through these three.
    typical = np.array([float(np.median(np.abs(d[k]))) for d, k in found])
    best = int(np.clip(typical.argmin(), 1, 2 * most - 1))
    # 1.4826 MAD is a normal's standard deviation; 1e-6 px: points that stand still without any noise.
    scale = max(1e-6, 1.4826 * float(typical[best - 1 : best + 2].max()))
    out = np.zeros((BLOCKS, len(found), 2))
    for i, (distance, known) in enumerate(found):
        start = max(0, most - i)
        block = (np.arange(len(distance)) + start) * BLOCKS // len(tracks)
        cost = np.minimum((distance / scale) ** 2, OUTLIER**2) * known
        out[:, i, 0] = np.bincount(block, cost.sum(axis=1), BLOCKS)
        out[:, i, 1] = np.bincount(block, known.sum(axis=1), BLOCKS)
    return out


def _mean(sums: np.ndarray) -> np.ndarray:
    """[P, shifts] mean cost over the blocks of time that are there."""
    total = sums.sum(axis=1)
    return np.asarray(total[..., 0] / np.maximum(total[..., 1], 1))


def _motion(rig: Rig, tracks: np.ndarray, a: int, b: int) -> float:
    """Px a frame across the epipolar lines of camera a in camera b, root mean square over joints and frames, less
    the noise of the tracks."""
    first, second, known = _aligned(tracks, a, b, 0)
    lines = homogeneous(first) @ fundamental(rig, a, b).T
    across = lines[..., :2] / np.maximum(np.linalg.norm(lines[..., :2], axis=-1, keepdims=True), 1e-12)
    both = known[2:] & known[1:-1] & known[:-2]
    if not both.any():
        return 0.0
    # Of white noise s a central step of two frames has variance s^2 / 2 and the second difference 6 s^2, a twelfth of
    # which is that.
    step = ((second[2:] - second[:-2]) / 2 * across[1:-1]).sum(axis=-1)[both]
    bend = ((second[2:] - 2 * second[1:-1] + second[:-2]) * across[1:-1]).sum(axis=-1)[both]
    return float(np.sqrt(max(0.0, np.median(step**2) - np.median(bend**2) / 12) / 0.4549))


def _whole(pairs: list[tuple[int, int]], cost: np.ndarray, views: int, most: int) -> np.ndarray:
    """[V] whole offsets of the least total cost: from every camera in turn as the reference, then camera by camera
    while it falls."""
    best, least = np.zeros(views, int), np.inf
    for start in range(views):
        offsets = np.zeros(views, int)
        for (a, b), c in zip(pairs, cost, strict=True):
            if start in (a, b):
                shift = int(c.argmin()) - most
                offsets[b if start == a else a] = shift if start == a else -shift
        offsets, total = _descended(pairs, cost, offsets, most)
        if total < least - 1e-12:
            best, least = offsets, total
    return best


def _descended(
    pairs: list[tuple[int, int]], cost: np.ndarray, offsets: np.ndarray, most: int
) -> tuple[np.ndarray, float]:
    def total(o: np.ndarray) -> float:
        return sum(
            float(c[int(np.clip(o[b] - o[a], -most, most)) + most]) for (a, b), c in zip(pairs, cost, strict=True)
        )

    now = total(offsets)
    for _ in range(10):
        before = now
        for v in range(len(offsets)):
            tries = [np.where(np.arange(len(offsets)) == v, s, offsets) for s in range(-most, most + 1)]
            costs = [total(t) for t in tries]
            if min(costs) < now - 1e-12:
                offsets, now = tries[int(np.argmin(costs))], min(costs)
        if now == before:
            break
    return offsets, now


def _refined(
    pairs: list[tuple[int, int]], cost: np.ndarray, whole: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Offsets [V] in frames near the whole ones, mean 0 within a group of linked cameras, and how deep [V] the least
    of each camera's pairs lies below their mean cost."""
    views = len(whole)
    laplacian, right, depth = np.zeros((views, views)), np.zeros(views), np.zeros(views)
    for (a, b), c in zip(pairs, cost, strict=True):
        shift = int(np.clip(whole[b] - whole[a], 1 - most, most - 1))
        low, middle, high = c[shift + most - 1 : shift + most + 2]
        bend = float(low - 2 * middle + high)
        depth[[a, b]] += c.mean() - middle
        if bend > 1e-9:
            # Minimum of the parabola; the weight of a pair is its curvature.
            least = shift + float(np.clip((low - high) / (2 * bend), -1.5, 1.5))
            laplacian[[a, b], [a, b]] += bend
            laplacian[[a, b], [b, a]] -= bend
            right[a] -= bend * least
            right[b] += bend * least
    return np.linalg.pinv(laplacian, hermitian=True) @ right, depth
