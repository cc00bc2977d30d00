"""The pose prior: where joints are known, nothing of a body lies far in front of its limbs.

Bones between triangulated joints are capsules, wide enough for flesh and cloth. What the silhouettes leave standing in
front of them, outside every capsule, is mostly a phantom of the visual hull. It need not be: hair, a skirt, a ball, a
limb whose joint is missing lie outside, too. They give themselves away: some view sees them in a pixel of its
silhouette that no capsule covers. So the near bound moves on along the ray from the hull to the first point that is in
a capsule or that a view sees in such a pixel, and stays where the ray meets no capsule within the hull.
"""

from __future__ import annotations

import math

import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.silhouettes.march import MOST_POINTS, into_views
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres, to_integer_centres
from posegaussian.storage.model.joint_sets import COCO17
from posegaussian.storage.model.masks import foreground

MARGIN = 0.05
"""Metres around a limb for cloth and for the joints' error, whatever the body's size. Simulated people in 30 poses,
exact joints: nothing lies more than 6 mm farther out, and that are fingertips."""
FARTHEST = 0.5
"""Metres by which the near bound moves at most: phantoms are rarely thicker."""
BONES = {
    ("LShoulder", "RShoulder"): (0.36, 0.11), ("LHip", "RHip"): (0.24, 0.15), ("*Shoulder", "*Hip"): (0.50, 0.11),
    ("*Shoulder", "*Elbow"): (0.29, 0.06), ("*Elbow", "*Wrist"): (0.25, 0.05), ("*Hip", "*Knee"): (0.42, 0.10),
    ("*Knee", "*Ankle"): (0.42, 0.075),
}  # fmt: skip
"""{bone: (length, radius)}, metres of a body of 1.75 m; `*` stands for both sides."""
SPINE, HEAD, NECK, FOOT = 0.13, 0.16, 0.10, 0.20
"""Radii of such a body's middle, from the shoulders to the hips; of its head around the middle of the ears, hair
included; of what joins the head to the shoulders; and of a ball around the ankle that holds a foot wherever it
points."""
HAND = (0.19, 0.06)
"""(length, radius) of a hand that continues the forearm."""
CHAINS = {("*Shoulder", "*Elbow", "*Wrist"): (0.74, 0.45), ("*Hip", "*Knee", "*Ankle"): (1.05, 0.63)}
"""{joints: metres by which the limb may reach beyond the first and the second of them, where the next is unknown}."""
HEAD_REACH = 0.45
"""Metres from the middle of the shoulders that hold a head whose ears are unknown."""
SIZES = (0.4, 1.3)
"""Body sizes that are believed, over 1.75 m."""


def _pairs() -> list[tuple[int, int, float, float]]:
    """(joint, joint, length, radius) of all bones."""
    sided = [
        (one.replace("*", s), other.replace("*", s), *sizes)
        for (one, other), sizes in BONES.items()
        for s in ("LR" if "*" in one else "L")
    ]
    return [
        (COCO17.names.index(one), COCO17.names.index(other), length, radius) for one, other, length, radius in sided
    ]


def _chains() -> list[tuple[list[int], tuple[float, float]]]:
    """(three joints, reaches) of all four limbs."""
    return [
        ([COCO17.names.index(n.replace("*", s)) for n in names], reaches)
        for names, reaches in CHAINS.items()
        for s in "LR"
    ]


_PAIRS, _ALL_CHAINS = _pairs(), _chains()
_EARS, _SHOULDERS, _ELBOWS, _WRISTS, _HIPS, _ANKLES = (
    [COCO17.names.index(s + n) for s in "LR"] for n in ("Ear", "Shoulder", "Elbow", "Wrist", "Hip", "Ankle")
)


def limbs_of(joints: np.ndarray) -> np.ndarray:
    """[N, 7] capsules (one end, other end, radius), world metres, margin included, of COCO-17 joints [17, 4] (x, y, z,
    score).

    A joint with score 0 takes part in none: a limb that it belongs to may be anywhere it reaches, a ball around its
    last known joint. Without both shoulders and hips there are no limbs. Radii grow with the body: the median length of
    its known bones over those of one of 1.75 m.
    """
    known, at = joints[:, 3] > 0, joints[:, :3].astype(np.float64)
    if not known[_SHOULDERS + _HIPS].all():
        return np.zeros((0, 7))
    size, found = _bones(known, at)
    found += _feet(known, at)
    for chain, reaches in _ALL_CHAINS:
        unknown = int(np.argmin(known[chain]))
        if not known[chain].all():
            found.append((at[chain[unknown - 1]], at[chain[unknown - 1]], reaches[unknown - 1]))
    if not known[_EARS].all():
        shoulders = at[_SHOULDERS].mean(axis=0)
        found.append((shoulders, shoulders, HEAD_REACH))
    return np.array([(*a, *b, size * radius + MARGIN) for a, b, radius in found])


def flesh_of(joints: np.ndarray, feet: bool = False) -> np.ndarray:
    """[N, 7] capsules as of `limbs_of`, without a margin, of what is surely there: no limb whose end is unknown, and no
    foot, which points anywhere, unless `feet` are asked for."""
    known, at = joints[:, 3] > 0, joints[:, :3].astype(np.float64)
    if not known[_SHOULDERS + _HIPS].all():
        return np.zeros((0, 7))
    size, found = _bones(known, at)
    found += _feet(known, at) if feet else []
    return np.array([(*a, *b, size * radius) for a, b, radius in found])


def _feet(known: np.ndarray, at: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """As of `_bones`, balls around the ankles that are known [17]."""
    return [(at[j], at[j], FOOT) for j in _ANKLES if known[j]]


def _bones(known: np.ndarray, at: np.ndarray) -> tuple[float, list[tuple[np.ndarray, np.ndarray, float]]]:
    """The body's size over that of 1.75 m, and (one end, other end, radius of that body) of bones whose ends [17, 3]
    are known [17], hands, spine, and a head whose ears are known."""
    bones = [(at[a], at[b], length, radius) for a, b, length, radius in _PAIRS if known[a] and known[b]]
    size = float(np.clip(np.median([np.linalg.norm(a - b) / length for a, b, length, _ in bones]), *SIZES))
    found = [(a, b, radius) for a, b, _, radius in bones]
    for elbow, wrist in zip(_ELBOWS, _WRISTS, strict=True):
        if known[elbow] and known[wrist]:
            forearm = at[wrist] - at[elbow]
            hand = HAND[0] * size * forearm / max(float(np.linalg.norm(forearm)), 1e-6)
            found.append((at[wrist], at[wrist] + hand, HAND[1]))
    shoulders, head = at[_SHOULDERS].mean(axis=0), at[_EARS].mean(axis=0)
    found.append((shoulders, at[_HIPS].mean(axis=0), SPINE))
    if known[_EARS].all():
        found += [(head, head, HEAD), (head, shoulders, NECK)]
    return size, found


def bounded(
    rig: Rig, hulls: dict[int, tuple[np.ndarray, np.ndarray]], masks: dict[int, np.ndarray], limbs: np.ndarray
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Near and far depth [h, w] by view, metres along the optical axis, 0 outside the hull: the near one moved on to
    the limbs.

    Args:
        rig: the cameras.
        hulls: near and far depth of the hull by view.
        masks: [h, w] uint8 by view, of views that may tell of a body beyond the limbs.
        limbs: [N, 7] capsules, world metres; with none, the hulls are returned as they are.

    The near bound never moves towards the camera nor beyond the far one.
    """
    if not len(limbs) or not masks:
        return hulls
    views = sorted(masks)
    unexplained = np.stack([_unexplained(rig, v, masks[v], limbs) for v in views])
    projections = to_integer_centres(rig.intrinsics[views]) @ rig.world_to_camera[views, :3]
    out = {}
    for v, (near, far) in hulls.items():
        rows, columns = np.nonzero(near > 0)
        moved = near.copy()
        moved[rows, columns] = _moved(
            near[rows, columns],
            far[rows, columns],
            *_rays(rig, v, rows, columns),
            limbs,
            unexplained,
            projections,
            1.0 / float(rig.intrinsics[v, 0, 0]),
        )
        out[v] = (moved, far)
    return out


def first_met(rig: Rig, view: int, wanted: np.ndarray, capsules: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth [h, w] float32, metres, at which the rays of the `wanted` pixels [h, w] bool enter the first of the
    capsules [N, 7], 0 where they meet none, and which of them that is, -1 for none."""
    depth, which = np.zeros(wanted.shape, np.float32), np.full(wanted.shape, -1, np.int32)
    rows, columns = np.nonzero(wanted)
    depth[rows, columns], which[rows, columns] = _first(*_rays(rig, view, rows, columns), capsules)
    return depth, which


@compiled
def _first(origin: np.ndarray, directions: np.ndarray, capsules: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth [n] at which rays [n, 3] enter the first capsule in front of the camera, and its index."""
    depth, which = np.zeros(len(directions), np.float32), np.full(len(directions), -1, np.int32)
    for n in range(len(directions)):
        nearest = np.inf
        for k in range(capsules.shape[0]):
            low, _ = _through(origin, directions[n], capsules[k])
            if 0 < low < nearest:
                nearest, depth[n], which[n] = low, low, k
    return depth, which


def _rays(rig: Rig, view: int, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rays(
        points_from_integer_centres(np.stack([columns, rows], axis=-1)), rig.intrinsics[view], rig.world_to_camera[view]
    )


def _unexplained(rig: Rig, view: int, mask: np.ndarray, limbs: np.ndarray) -> np.ndarray:
    """[h, w] bool: pixels of the silhouette whose rays meet no limb, and those beside them."""
    import cv2

    width, height = rig.size[view]
    rows, columns = np.nonzero(foreground(mask[:height, :width]))
    alone = np.zeros(mask.shape, np.uint8)
    alone[rows, columns] = ~_covered(*_rays(rig, view, rows, columns), limbs)
    return cv2.dilate(alone, np.ones((3, 3), np.uint8)) > 0


@compiled
def _covered(origin: np.ndarray, directions: np.ndarray, limbs: np.ndarray) -> np.ndarray:
    """[n] bool: whether rays [n, 3] meet a limb in front of the camera."""
    out = np.zeros(len(directions), np.bool_)
    for n in range(len(directions)):
        out[n] = _entry(0.0, origin, directions[n], limbs) < np.inf
    return out


@compiled
def _entry(start: float, origin: np.ndarray, d: np.ndarray, limbs: np.ndarray) -> float:
    """Depth, at least `start`, of the first point of a ray that is in a limb; infinite where there is none."""
    first = np.inf
    for n in range(limbs.shape[0]):
        low, high = _through(origin, d, limbs[n])
        if high >= start:
            first = min(first, max(low, start))
    return first


@compiled
def _through(origin: np.ndarray, d: np.ndarray, limb: np.ndarray) -> tuple[float, float]:
    """Depths at which the ray origin + depth * d enters and leaves a capsule; (inf, -inf) where it misses it.

    A capsule is convex, and the union of a cylinder and of two balls: the ray is in it from the first entry to the last
    exit.
    """
    low, high, square = np.inf, -np.inf, limb[6] * limb[6]
    dd, da, aa, ma, md, mm = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        axis, to = limb[3 + k] - limb[k], origin[k] - limb[k]
        dd, da, aa, ma, md, mm = (
            dd + d[k] * d[k],
            da + d[k] * axis,
            aa + axis * axis,
            ma + to * axis,
            md + to * d[k],
            mm + to * to,
        )
    for end in range(2 if aa > 0 else 1):
        # A ball: |to + depth d - end axis|^2 = radius^2.
        half, rest = md - end * da, mm - 2 * end * ma + end * aa - square
        inside = half * half - dd * rest
        if inside > 0:
            root = math.sqrt(inside)
            low, high = min(low, (-half - root) / dd), max(high, (-half + root) / dd)
    across = dd * aa - da * da
    if across > 1e-12 * dd * aa:
        half, rest = md * aa - ma * da, (mm - square) * aa - ma * ma
        inside = half * half - across * rest
        if inside > 0:
            root = math.sqrt(inside)
            enter, leave = (-half - root) / across, (-half + root) / across
            # Between the cylinder's ends: 0 <= ma + depth da <= aa.
            if da != 0.0:
                one, other = -ma / da, (aa - ma) / da
                enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
            elif ma < 0 or ma > aa:
                leave = -np.inf
            if enter < leave:
                low, high = min(low, enter), max(high, leave)
    return low, high


@compiled
def _moved(
    near: np.ndarray,
    far: np.ndarray,
    origin: np.ndarray,
    directions: np.ndarray,
    limbs: np.ndarray,
    unexplained: np.ndarray,
    projections: np.ndarray,
    pixel: float,
) -> np.ndarray:
    """Near depth [n] moved on along rays [n, 3], in steps of a px of the view; `pixel` is a px in metres at a depth
    of one."""
    out = near.copy()
    views = projections.shape[0]
    start, along = np.empty((views, 3)), np.empty((views, 3))
    for n in range(len(near)):
        first, last = float(near[n]), _entry(float(near[n]), origin, directions[n], limbs)
        if not first < last <= far[n]:
            continue
        last = min(last, first + FARTHEST)
        into_views(origin, directions[n], projections, start, along)
        steps = int(min((last - first) / (pixel * first), MOST_POINTS)) + 1
        for i in range(steps + 1):
            z = first + (last - first) * i / steps
            if _alone(z, start, along, unexplained):
                break
            out[n] = z
    return out


@compiled
def _alone(z: float, start: np.ndarray, along: np.ndarray, unexplained: np.ndarray) -> bool:
    """Whether a view sees a ray's point at depth z in a pixel of its silhouette that no limb explains."""
    for v in range(start.shape[0]):
        w = start[v, 2] + z * along[v, 2]
        if w <= 1e-9:
            continue
        x, y = (start[v, 0] + z * along[v, 0]) / w, (start[v, 1] + z * along[v, 1]) / w
        if (
            -0.5 <= x < unexplained.shape[2] - 0.5
            and -0.5 <= y < unexplained.shape[1] - 0.5
            and unexplained[v, int(y + 0.5), int(x + 0.5)]
        ):
            return True
    return False
