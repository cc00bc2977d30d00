"""Which source views make a picture, and how strongly: nearest in angle first, fading out before they are replaced; and
how much of it the refined Gaussians of all views are.

A close-up, or a picture that cuts the subject off, says nothing of what lies beside it: there the next nearest views
draw in its place, Gaussian by Gaussian."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from posegaussian.stages.contract.facts import Facts, fact
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.network.params import TWISTED, depth_array
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import foreground

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
BORDER = 2
"""Px from the border of a picture within which what a mask holds is cut off by it."""
MARGIN = 0.01
"""Of a picture's longer side, by which a point must lie within it for others to leave it to that view: up to its border
a surface that is a little off has a gap."""
MOST = 8
"""Views that are looked at for one picture, at most: where all of many cut the subject off, the nearest show enough."""


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


def cut_off(mask: np.ndarray, size: np.ndarray) -> bool:
    """Whether a mask [h, w] uint8, of a picture of `size` [2] (width, height) px, goes on beyond its border."""
    inside = foreground(mask[: size[1], : size[0]])
    sides = inside[:BORDER], inside[-BORDER:], inside[:, :BORDER], inside[:, -BORDER:]
    return any(bool(side.any()) for side in sides)


def asked(angles: np.ndarray, usable: np.ndarray, parts: frozenset[int], count: int) -> list[int] | None:
    """The views that may have a say in a picture somewhere, nearest first, where some of the nearest are `parts`, views
    that cut the subject off; None where all of it is `choose`'s to say.

    angles [V] rad, usable [V] bool. Of those that show all of the subject one more than the `count` that draw it has a
    say: it tells how far these reach.
    """
    order = [int(v) for v in np.argsort(angles, kind="stable") if usable[v]]
    if not parts.intersection(order[: count + 1]):
        return None
    whole = [n for n, v in enumerate(order) if v not in parts]
    return order[: min(whole[count] + 1 if len(whole) > count else len(order), MOST)]


def shown(rig: Rig, points: np.ndarray, view: int, views: Sequence[int], parts: frozenset[int]) -> np.ndarray:
    """[N, V] bool: which of the `views` show each of a view's own points [N, 3], world metres. Those that are no
    `parts` show all of them, and the view itself does."""
    out = np.zeros((len(points), len(rig)), bool)
    out[:, list(views)] = True
    for other in parts.intersection(views) - {view}:
        pixels, depth = project(points, rig.intrinsics[other], rig.world_to_camera[other])
        low = MARGIN * float(rig.size[other].max())
        out[:, other] = (depth > 0) & (pixels >= low).all(axis=1) & (pixels <= rig.size[other] - low).all(axis=1)
    return out


def weights(
    angles: np.ndarray,
    usable: np.ndarray,
    parts: frozenset[int],
    count: int,
    shown_of: Callable[[int, Sequence[int]], np.ndarray],
) -> Mapping[int, np.ndarray | float]:
    """{view: weight 0..1, or [N] of each of its Gaussians} of the views that draw a picture, as `choose` weighs those
    that show the place.

    `shown_of` (view, views): [N, V] bool, as `shown` has it, of the view's Gaussians.
    """
    views = asked(angles, usable, parts, count)
    if views is None:
        return dict(choose(angles, usable, count))
    known: dict[bytes, dict[int, float]] = {}
    found: dict[int, np.ndarray | float] = {}
    for view in views:
        kinds, which = np.unique(np.packbits(shown_of(view, views), axis=1), axis=0, return_inverse=True)
        own = np.zeros(len(kinds))
        for n, kind in enumerate(kinds):
            if (key := kind.tobytes()) not in known:
                showing = np.unpackbits(kind, count=len(angles)).astype(bool)
                known[key] = dict(choose(angles, usable & showing, count))
            own[n] = known[key].get(view, 0.0)
        if (own > 0).any():
            found[view] = own[which.reshape(-1)]
    return found


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
