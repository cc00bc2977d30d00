"""How cameras stand turned, by what their silhouettes say of each other.

A ray through the rim of a silhouette grazes the subject, so that somewhere along it every other view must see some of
it (Hernandez, Schmitt and Cipolla, "Silhouette coherence for camera calibration under circular motion", 2007). By how
many px the best place of a ray lies outside the silhouettes of others is 0 of exact cameras and masks, whatever the
shape, and some px where a camera looks elsewhere. Which cameras these are is told by leaving them out, for the rest is
coherent then; and by which turn they become coherent with it, by a search. Features, outermost points of outlines and
joints tell nothing of a camera that is turned along the lines of the others, as all are that stand in a level ring.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.small_turns import APART, SIDE, turned
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius
from posegaussian.stages.silhouettes.march import (
    MOST_POINTS,
    farthest_outside,
    in_sphere,
    into_views,
    motion,
    nearest_to,
    watched,
)
from posegaussian.stages.silhouettes.tangents import Outline, outline, turns_of_all
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres, to_integer_centres
from posegaussian.storage.model.masks import foreground

FEWEST = 4
"""Views among which one can be told to be wrong; of six two can, of nine three."""
MOST_WRONG = 3
RIM = 150
"""Rays of a view that are walked, about."""
STEP = 2.0
"""Px from one point of a ray to the next."""
FAR = 16.0
"""Px outside a silhouette that count as no more."""
INCOHERENT = 0.06
"""Px, mean over views, from which on it is asked who is wrong: a head whose masks are a px off has 0.02, exact people
0.000 to 0.005, six cameras of which two are rolled by 2 degrees 0.07."""
REST = 0.15
"""Share of that which those that are right may have among each other, at most."""
CURED = 0.05
"""The same of all once the wrong ones are turned, beyond what those that are right have."""
TIMES, SECOND = 4.0, 0.02
"""Times what the best set of cameras leaves, and share of what there was before, that any other one must leave more, or
it is not clear who is wrong. Opposite cameras contradict each other most: of six of which one is turned by 7 px the
opposite one, turned in its place, leaves 0.1 of what there was, the right one 0.00."""
BEAM = 6
"""Sets of cameras of a size that are enlarged, and tried."""
ASKED = 16
"""Cameras that are right, evenly spread over the rig, by which wrong ones are turned: of 48 a second and more a try."""
COARSE, FINE = 10.0, 0.25
"""Px of the first and the last step of the search for a turn."""
ROOM = 0.003
"""Px, mean over views, by which turns may be less good and count as as good: what exact cameras have."""
ROLLED = 3.0
"""Times that step of a roll, whose px are those at a distance of a focal length from the middle."""


@dataclass(frozen=True, eq=False)
class Outlined:
    """The silhouettes of one frame, and rays through their rims."""

    silhouettes: Silhouettes
    rims: Mapping[int, np.ndarray]
    """By view, [n, 2] px, our pixel centres."""
    counts: Mapping[int, int]
    """By view, how many rays its mean is of; those that are not among them are coherent."""
    outlines: Mapping[int, Outline]
    """By view, its corners, and which are free."""

    @classmethod
    def of(cls, rig: Rig, masks: Mapping[int, np.ndarray]) -> Outlined:
        """Of masks [h, w] uint8 by view index, in pixels of the rig."""
        seen = [v for v in sorted(masks) if foreground(masks[v]).any()]
        centre = look_at_point(rig.subset(seen)) if seen else np.zeros(3)
        radius = searched_radius(rig, seen, centre) if seen else 0.0
        shown = {v: masks[v][: rig.size[v, 1], : rig.size[v, 0]] for v in seen}
        rims = {v: _rim(mask) for v, mask in shown.items()}
        silhouettes = Silhouettes.of(rig, {v: masks[v] for v in seen}, centre, radius)
        counts, ends = {v: len(r) for v, r in rims.items()}, {v: outline(m) for v, m in shown.items()}
        return cls(silhouettes, rims, counts, ends)

    def excess(self, rig: Rig, view: int) -> np.ndarray:
        """[n] px of the rig's largest pictures by which the best place of each ray of a view lies outside the
        silhouettes of the others, at most `FAR`, with the cameras as they stand in `rig`."""
        s = self.silhouettes
        origin, directions = rays(self.rims[view], rig.intrinsics[view], rig.world_to_camera[view])
        others, sides = s.asked(origin, view)
        longest = float(rig.size.max())
        if not len(others):
            return np.zeros(len(directions))
        return _excess(
            origin,
            directions,
            others,
            sides,
            s.distance,
            s.projections,
            s.sizes,
            longest / s.sizes.max(axis=1),
            s.centre,
            s.radius,
            STEP * s.pixel,
            FAR * longest / SIDE,
        )

    def among(self, views: Sequence[int]) -> Outlined:
        """Of these views alone."""
        return replace(self, silhouettes=self.silhouettes.kept(set(views)))

    def standing(self, rig: Rig) -> Outlined:
        """The same silhouettes, of cameras as they stand in `rig`."""
        views = list(self.silhouettes.views)
        projections = to_integer_centres(rig.intrinsics[views]) @ rig.world_to_camera[views, :3]
        return replace(self, silhouettes=replace(self.silhouettes, projections=projections))

    def doubted(self, rig: Rig) -> Outlined:
        """With those rays alone that are not coherent: among fewer views the others are so all the more."""
        kept = {v: rim[self.excess(rig, v) > 0] for v, rim in self.rims.items()}
        return replace(self, rims=kept)


@dataclass(frozen=True, eq=False)
class Moved:
    """When a camera was moved, and how."""

    before: int
    """The last frame in which it stands as before, of those that were asked."""
    after: int
    """The first in which it does not."""
    by: np.ndarray
    """[3] rad in its axes from one to the other."""


@dataclass(frozen=True, eq=False)
class Standing:
    """How cameras stand."""

    turns: np.ndarray
    """[V, 3] rad in each camera's axes, 0 of cameras that are not turned."""
    wrong: frozenset[int]
    """Cameras that contradict the others however they are turned."""
    exchanged: bool
    """Whether two wrong cameras would be coherent with the others, did each stand in the other's place."""
    apart: np.ndarray
    """[V] px of the rig's largest pictures, mean over its rays or median over its joints, by which a camera that is
    turned or wrong contradicts those that are right, as it is written down; 0 of all others."""
    by_joints: bool = False
    """Whether joints told it, in place of silhouettes."""
    mirrored: bool = False
    """Whether the only wrong camera would be coherent with the others, were its pictures mirrored left-right."""
    moved: Mapping[int, Moved] = field(default_factory=dict)
    """Cameras that did not stand still, which no turn makes right."""
    lacking: frozenset[int] = frozenset()
    """Cameras that stand right, and whose masks lack something that those of the others have."""
    late: Mapping[int, float] = field(default_factory=dict)
    """Frames by which cameras are late that show another moment than the others."""
    upside_down: frozenset[int] = frozenset()
    """Cameras that are wrong, and whose joints would lie right, were their pictures turned by 180 degrees."""


def standing(rig: Rig, frames: Sequence[Outlined]) -> Standing:
    """Of silhouettes of a few frames, as far as at least `FEWEST` views see anything in one: the fewest cameras that
    are wrong, turned to be coherent with the others, or told as wrong where no turn makes them so; nobody where that
    can be told of several. Then the same of cameras that stand so, as a small error hides behind a large one.
    """
    frames = [f for f in frames if len(f.silhouettes.views) >= FEWEST]
    views = sorted(set.intersection(*(set(f.silhouettes.views) for f in frames))) if frames else []
    found, most = as_written(rig), min(MOST_WRONG, len(views) // 3)
    while len(views) >= FEWEST:
        stand = turned(rig, found.turns)
        now = [f.standing(stand) for f in frames]
        more = _fewest(stand, now, views, most - int((found.apart > 0).sum()))
        if more is None:
            break
        # Turned once and again is turned by both as far as turns are small; the second of a camera is.
        apart = np.maximum(found.apart, more.apart)
        found = replace(more, turns=found.turns + more.turns, apart=apart)
        if more.wrong:
            break
    return found


def as_written(rig: Rig) -> Standing:
    """All cameras as they are written down."""
    return Standing(np.zeros((len(rig), 3)), frozenset(), False, np.zeros(len(rig)))


def _fewest(rig: Rig, frames: Sequence[Outlined], views: Sequence[int], most: int) -> Standing | None:
    """The fewest of `views` that are wrong, at most so many; None where it is nobody, or not clear."""
    pixel = float(rig.size.max()) / SIDE
    before = contradiction(rig, frames, views)
    if before < INCOHERENT * pixel:
        return None
    doubted, sets = [f.doubted(rig) for f in frames], [frozenset[int]()]
    for _ in range(most):
        larger = sorted({s | {v} for s in sets for v in views if v not in s}, key=sorted)
        rest = {s: contradiction(rig, doubted, [v for v in views if v not in s]) for s in larger}
        sets = sorted(larger, key=lambda s: (rest[s], sorted(s)))[:BEAM]
        suspected = [s for s in sets if rest[s] <= REST * before]
        if suspected:
            return _told(rig, frames, views, suspected, rest, before)
    return None


def _told(
    rig: Rig,
    frames: Sequence[Outlined],
    views: Sequence[int],
    suspected: Sequence[frozenset[int]],
    rest: Mapping[frozenset[int], float],
    before: float,
) -> Standing | None:
    """What is wrong with one of several sets of cameras without which the `rest` is coherent; None where that is not
    clear."""
    tried = {s: _turned_back(rig, frames, views, s) for s in suspected}
    best = clear({s: left for s, (_, left) in tried.items()}, before)
    if best is not None and tried[best][1] <= rest[best] + CURED * before:
        # Many a bit off look like few far off.
        every = _left(rig, frames, views, turns_of_all(rig, views, [f.outlines for f in frames]))
        if every <= tried[best][1] + ROOM * float(rig.size.max()) / SIDE:
            return None
        turns = _amid(rig, frames, views, best, tried[best][0])
        return Standing(turns, frozenset(), False, _apart(rig, frames, views, best))
    best = clear({s: rest[s] for s in suspected}, before)
    if best is None:
        return None
    apart, all_of_them = _apart(rig, frames, views, best), mean_by_view(rig, frames, views)
    of_others = float(np.mean([px for v, px in all_of_them.items() if v not in best]))
    if min(of_others, *apart[sorted(best)]) < APART * float(rig.size.max()) / SIDE:
        return None
    exchanged, mirrored = (asked(rig, frames, views, best, before) for asked in (_exchanged, _mirrored))
    return replace(as_written(rig), wrong=best, exchanged=exchanged, mirrored=mirrored, apart=apart)


def _exchanged(
    rig: Rig, frames: Sequence[Outlined], views: Sequence[int], wrong: frozenset[int], before: float
) -> bool:
    """Whether two cameras are coherent with the others, each in the other's place."""
    if len(wrong) != 2:
        return False
    one, other = sorted(wrong)
    order = np.arange(len(rig))
    order[[one, other]] = other, one
    stand = replace(
        rig, world_to_camera=rig.world_to_camera[order], intrinsics=rig.intrinsics[order], size=rig.size[order]
    )
    return contradiction(stand, [f.standing(stand) for f in frames], views) <= REST * before


def _mirrored(rig: Rig, frames: Sequence[Outlined], views: Sequence[int], wrong: frozenset[int], before: float) -> bool:
    """Whether the only wrong camera is coherent with the others as one whose pictures are mirrored left-right."""
    if len(wrong) != 1:
        return False
    (v,), intrinsics = wrong, rig.intrinsics.copy()
    intrinsics[v] = np.array([[-1.0, 0, rig.size[v, 0]], [0, 1, 0], [0, 0, 1]]) @ intrinsics[v]
    stand = replace(rig, intrinsics=intrinsics)
    return contradiction(stand, [f.standing(stand) for f in frames], views) <= REST * before


def clear(left: Mapping[frozenset[int], float], before: float) -> frozenset[int] | None:
    """The set of views without which least is left, px, of what there was `before`; None where without another one
    nearly as little is."""
    best, *others = sorted(left, key=lambda s: (left[s], sorted(s)))
    return best if all(left[s] > TIMES * left[best] + SECOND * before for s in others) else None


def _apart(rig: Rig, frames: Sequence[Outlined], views: Sequence[int], wrong: frozenset[int]) -> np.ndarray:
    """[V] px by which each of the wrong cameras contradicts those that are right."""
    out, right = np.zeros(len(rig)), [v for v in views if v not in wrong]
    for v in sorted(wrong):
        out[v] = mean_by_view(rig, frames, [*right, v])[v]
    return out


def mean_by_view(rig: Rig, frames: Sequence[Outlined], views: Sequence[int]) -> dict[int, float]:
    """By view, px by which its rays contradict the others of `views`, mean over rays and frames."""
    alone = [f.among(views) for f in frames]
    return {v: float(np.mean([f.excess(rig, v).sum() / max(f.counts[v], 1) for f in alone])) for v in views}


def contradiction(rig: Rig, frames: Sequence[Outlined], views: Sequence[int]) -> float:
    """Px by which `views` contradict each other as they stand in `rig`, mean over rays, frames and views."""
    return float(np.mean(list(mean_by_view(rig, frames, views).values())))


def _turned_back(
    rig: Rig, frames: Sequence[Outlined], views: Sequence[int], wrong: frozenset[int]
) -> tuple[np.ndarray, float]:
    """Turns [V, 3] rad of the wrong cameras that make them most coherent with the others of `views`, or `ASKED` of
    these, one after another, then with one another, too; and the px that are left, mean over `views`."""
    right = [v for v in views if v not in wrong]
    turns, asked = np.zeros((len(rig), 3)), right[:: -(-len(right) // ASKED)]
    for v in sorted(wrong):
        asked = sorted([*asked, v])
        turns = _search(rig, frames, asked, v, turns)
    for v in sorted(wrong) if len(wrong) > 1 else ():
        turns = _search(rig, frames, asked, v, turns)
    return turns, _left(rig, frames, views, turns)


def _search(rig: Rig, frames: Sequence[Outlined], views: Sequence[int], view: int, turns: np.ndarray) -> np.ndarray:
    """[V, 3] rad with the turn of one camera at which `views` are most coherent, from where it is in `turns` on: steps
    along yaw, pitch and roll, half as long where none is better."""
    alone, axes, step = [f.among(views) for f in frames], _axes(rig, view), COARSE
    far = [_moved(turns, view, n * step * axis) for axis in axes[:2] for n in range(-4, 5)]
    best, turns = min(((_left(rig, alone, views, at), at) for at in far), key=lambda found: found[0])
    while step >= FINE:
        steps = [_moved(turns, view, sign * step * axis) for axis in axes for sign in (1, -1)]
        least, at = min(((_left(rig, alone, views, at), at) for at in steps), key=lambda found: found[0])
        if least < best - 1e-9:
            best, turns = least, at
        else:
            step /= 2
    return turns


def _amid(
    rig: Rig, frames: Sequence[Outlined], views: Sequence[int], wrong: frozenset[int], turns: np.ndarray
) -> np.ndarray:
    """The same, amid the turns of the wrong cameras that are as good along each axis of one and of two of them:
    silhouettes leave some room, and a search ends where it enters it."""
    alone = [f.among(views) for f in frames]
    most = _left(rig, alone, views, turns) + ROOM * float(rig.size.max()) / SIDE

    def reach(along: np.ndarray) -> float:
        good, step = 0.0, FINE
        while step <= COARSE and _left(rig, alone, views, turns + (good + step) * along) <= most:
            good, step = good + step, 2 * step
        while (step := step / 2) >= FINE:
            if _left(rig, alone, views, turns + (good + step) * along) <= most:
                good += step
        return good

    none = np.zeros_like(turns)
    single = {v: [_moved(none, v, axis) for axis in _axes(rig, v)] for v in sorted(wrong)}
    pairs = [(v, w) for v in sorted(wrong) for w in sorted(wrong) if v < w]
    double = [a + sign * b for v, w in pairs for a, b in zip(single[v], single[w], strict=True) for sign in (1, -1)]
    for along in [*double, *(a for axes in single.values() for a in axes)] * 2:
        turns = turns + (reach(along) - reach(-along)) / 2 * along
    return turns


def _axes(rig: Rig, view: int) -> np.ndarray:
    """[3, 3] rad of a turn by a px of a picture of `SIDE` px: yaw, pitch, and roll, see `ROLLED`."""
    one = float(rig.size[view].max()) / SIDE / rig.intrinsics[view, 0, 0]
    return one * np.eye(3)[[1, 0, 2]] * np.array([[1.0], [1.0], [ROLLED]])


def _moved(turns: np.ndarray, view: int, by: np.ndarray) -> np.ndarray:
    """[V, 3] rad, of one view by so much more."""
    out = turns.copy()
    out[view] += by
    return out


def _left(rig: Rig, alone: Sequence[Outlined], views: Sequence[int], turns: np.ndarray) -> float:
    """Px by which `views` contradict each other, turned."""
    stand = turned(rig, turns)
    return contradiction(stand, [f.standing(stand) for f in alone], views)


def _rim(mask: np.ndarray) -> np.ndarray:
    """[n, 2] px, our pixel centres, of some pixels of a mask's rim amid the picture."""
    inside = foreground(mask).astype(np.uint8)
    rim = (inside > 0) & (cv2.erode(inside, np.ones((3, 3), np.uint8), borderValue=1) == 0)
    rim[[0, -1]], rim[:, [0, -1]] = False, False
    rows, columns = np.nonzero(rim)
    some = slice(None, None, max(1, len(rows) // RIM))
    return points_from_integer_centres(np.stack([columns[some], rows[some]], axis=-1))


@compiled
def _excess(
    origin: np.ndarray,
    directions: np.ndarray,
    others: np.ndarray,
    sides: int,
    distance: np.ndarray,
    projections: np.ndarray,
    sizes: np.ndarray,
    scales: np.ndarray,
    centre: np.ndarray,
    radius: float,
    pixel: float,
    far: float,
) -> np.ndarray:
    """[N] px, `scales` [S] of them a px of each view, by which the best place of a ray lies outside the silhouettes of
    `others`, of which the first `sides` look from the side, at most `far`; `pixel` metres a step."""
    count = projections.shape[0]
    out, order = np.full(len(directions), far), others.copy()
    start, along, moves = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    for n in range(len(directions)):
        d = directions[n]
        first, last = in_sphere(origin - centre, d, radius)
        into_views(origin, d, projections, start, along)
        motion(start, along, moves)
        first, last = watched(start, along, sizes, others, sides, nearest_to(origin - centre, d), 0, first, last)
        step = pixel / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        points, i = min((last - first) / step, MOST_POINTS), 0.0
        while i <= points and out[n] > 0:
            worst, on = farthest_outside(first + i * step, start, along, moves, distance, sizes, scales, order, out[n])
            out[n] = min(out[n], worst)
            i += max(1.0, np.floor(on / step))
    return out
