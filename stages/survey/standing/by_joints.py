"""How cameras stand turned, by where they see the joints of a person: of captures without masks.

Rays through one joint meet in one point, whichever cameras see it. Those of a camera that is turned pass it by, along
the lines of the others as well as across them, once three others see it. A detector errs by some px, and differently on
a body that is seen from elsewhere, so that only larger turns are told; and only those that bring all joints of a camera
back to the others at once. A turn does so, nearly, for another moment of somebody who walks by, and for somebody else
who stands beside: nobody is turned where that explains it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from posegaussian.stages.geometry.points import NEAR, project
from posegaussian.stages.geometry.triangulation import Tracks, meeting, residuals
from posegaussian.stages.imaging.small_turns import SIDE, turned
from posegaussian.stages.pose.subject_choice import subject
from posegaussian.stages.silhouettes.coherence import BEAM, FEWEST, MOST_WRONG, Moved, Standing
from posegaussian.stages.survey.algorithms.joints import RESIDUAL, SCORE
from posegaussian.stages.survey.standing.moved import ASKED, otherwise
from posegaussian.storage.model.cameras import Rig, rigid

APART = 5.0
"""Px of a picture of `SIDE` px by which the joints of a camera that is turned lie beside those of the others, median.
Of twelve people, filmed and simulated, whose cameras stand right they do by 0 to 7, as detectors err, and by no less
once they are turned."""
NEARER = 1.6
"""Times nearer they must lie once it is turned back."""
SINCE = 2.5
"""Times nearer they must lie in each frame before, and in each after, as the camera stands there than as it stands in
the other, where it was moved in between. Cameras moved by 12 px of 512 and more have 3.7 to 16; one of a rig that stood
still, whose man is half hidden by a woman in the last frames, 1.7 to 3.2."""
CURED, EXACT = 3.0, 1.0
"""Times what is left then may be what those that are right have among each other, or px of a picture of `SIDE` px where
that is next to nothing. 281 cameras that were turned back have 0.6 to 2.6, one of another
moment 12."""
CLEAR = 1.0
"""Times what is left of a camera that must be left more, of all together, with other cameras turned: with half of that
one of sixteen cameras that stand right was turned."""
FARTHEST = np.radians(20.0)
"""Turn beyond which a camera was not bumped."""
AS_WELL = 1.3
"""Times what a turn leaves up to which another moment explains joints as well."""
LATEST = 30
"""Frames by which a camera may be out of step, either way."""
PART = 0.5
"""Frames from one moment that is tried to the next."""
FEWEST_JOINTS = 12
"""Joints, of all frames together, that a camera must share with two others."""
SCATTER = 2.0
"""Px beyond which a joint counts less when a turn is fitted (Huber)."""
STEPS = 10


@dataclass(frozen=True, eq=False)
class _Tried:
    """What becomes of some cameras that are turned to where the joints lie that all others see."""

    wrong: frozenset[int]
    """Which."""
    turns: np.ndarray
    """[S, 3] rad in each camera's axes."""
    apart: np.ndarray
    """[S] px of a picture of `SIDE` px, median over their joints, as they are written down; 0 of the others."""
    after: np.ndarray
    """[S] the same once they are turned."""
    mended: bool
    """Whether they are apart, and no longer once they are turned."""
    left: float
    """Px by which joints of all cameras then lie beside where their rays meet, mean over cameras."""


def same_person_first(rig: Rig, people: np.ndarray) -> np.ndarray:
    """[S, F, P, J, 3] of the people each of S views shows, as `standing_by_joints` asks for them, with whom the views
    agree on in a frame moved to the front in those that do: of several people the largest in one picture is not the
    largest in another, where cameras that stand right would look turned."""
    first = people.copy()
    for f in range(people.shape[1]):
        chosen = subject(rig, list(people[:, f]), SCORE, RESIDUAL)
        for v in np.flatnonzero(chosen[..., 2].any(axis=1)):
            which = int((people[v, f] == chosen[v]).all(axis=(1, 2)).argmax())
            first[v, f] = np.concatenate([people[v, f, which : which + 1], np.delete(people[v, f], which, axis=0)])
    return first


def standing_by_joints(rig: Rig, people: np.ndarray, numbers: np.ndarray) -> Standing:
    """How S cameras stand by the joints [S, F, P, J, 3] (u, v, score) of the people each shows in frames `numbers` [F],
    px of the rig, the largest first: the fewest of them turned so that the joints of theirs lie where those of the
    others do; nobody where that is not clear, or something else explains it as well.

    Then the same of cameras that stand so, as a small turn hides behind a large one. Cameras that stand otherwise by
    the first frames than by the last were moved in between: they are told so, and have no say.
    """
    found = _standing(rig, people, numbers)
    moved = _moved(turned(rig, found.turns), people, numbers)
    if not moved:
        return found
    heard = people.copy()
    heard[sorted(moved), ..., 2] = 0.0
    return replace(_standing(rig, heard, numbers), moved=moved)


def _moved(rig: Rig, people: np.ndarray, numbers: np.ndarray) -> dict[int, Moved]:
    """The cameras that were moved between two of the frames: in each of those before their joints lie nearer where the
    others see them as they stand by the first frames, in each of those after as by the last."""
    if len(numbers) < 2 * ASKED:
        return {}
    parts = (slice(ASKED), slice(-ASKED, None))
    before, after = (_standing(rig, people[:, part], numbers[part]).turns for part in parts)
    who = sorted(otherwise(rig, before, after))
    if not who or len(who) > len(rig) // 3:
        return {}
    joints, right = people[:, :, 0], [v for v in range(len(rig)) if v not in who]
    at_first, at_last = (_beside_of_frames(turned(rig, turns), joints, right)[:, who] for turns in (before, after))
    as_first = [bool((SINCE * first <= last).all()) for first, last in zip(at_first, at_last, strict=True)]
    as_last = [bool((SINCE * last <= first).all()) for first, last in zip(at_first, at_last, strict=True)]
    count = sum(as_first)
    once = all(as_first[:count]) and all(as_last[count:])
    if not once or not ASKED <= count <= len(numbers) - ASKED:
        return {}
    first, last = int(numbers[count - 1]), int(numbers[count])
    return {v: Moved(first, last, after[v] - before[v]) for v in who}


def _beside_of_frames(rig: Rig, joints: np.ndarray, right: Sequence[int]) -> np.ndarray:
    """[F, S] px of a picture of `SIDE` px by which the joints [S, F, J, 3] of each frame lie beside where those of the
    cameras that are `right` meet, median; infinite of none."""
    tracks = Tracks.of(rig, np.arange(len(rig)), joints.reshape(len(rig), -1, 3), SCORE)
    known = ((tracks.weights[right] > 0).sum(axis=0) >= 2)[:, None] & (tracks.weights.T > 0)
    off = np.where(known, _off(rig, tracks, meeting_points(tracks, right)), np.nan)
    of_frames = np.moveaxis(off.reshape(*joints.shape[1:3], len(rig)), 1, 0)
    told = np.isfinite(of_frames).any(axis=0)
    return np.where(told, np.nanmedian(np.where(told, of_frames, 0.0), axis=0), np.inf)


def _standing(rig: Rig, people: np.ndarray, numbers: np.ndarray) -> Standing:
    """The same, of cameras that stood still."""
    joints = people[:, :, 0].reshape(len(rig), -1, 3)
    tracks, wrong = Tracks.of(rig, np.arange(len(rig)), joints, SCORE), frozenset[int]()
    found = _Tried(wrong, np.zeros((len(rig), 3)), np.zeros(len(rig)), np.zeros(len(rig)), True, 0.0)
    while len(rig) >= FEWEST:
        more = _fewest(turned(rig, found.turns), joints, min(MOST_WRONG, len(rig) // 3) - len(wrong))
        together = turned_back(rig, joints, tracks, wrong | more.wrong) if more and not more.wrong <= wrong else None
        if together is None or not together.mended or _otherwise(rig, people, numbers, tracks, together):
            break
        found, wrong = together, together.wrong
    return Standing(found.turns, frozenset(), False, found.apart * float(rig.size.max()) / SIDE, by_joints=True)


def _fewest(rig: Rig, joints: np.ndarray, most: int) -> _Tried | None:
    """The fewest cameras that are turned, at most so many; None where it is nobody, or not clear."""
    tracks, views = Tracks.of(rig, np.arange(len(rig)), joints, SCORE), range(len(rig))
    sets = [frozenset[int]()]
    for _ in range(most):
        larger = sorted({s | {v} for s in sets for v in views if v not in s}, key=sorted)
        sets = sorted(larger, key=lambda s: (scatter(rig, tracks, set(views) - s), sorted(s)))[:BEAM]
        tried = sorted(filter(None, (turned_back(rig, joints, tracks, s) for s in sets)), key=lambda t: t.left)
        if not tried:
            continue
        best, *others = tried
        if best.mended and all(t.left >= (1 + CLEAR / len(rig)) * best.left for t in others):
            return best
    return None


def turned_back(rig: Rig, joints: np.ndarray, tracks: Tracks, wrong: frozenset[int]) -> _Tried | None:
    """Some cameras turned to the others; None where they share too few joints with these."""
    right = [v for v in range(len(rig)) if v not in wrong]
    points, known = meeting_points(tracks, right), (tracks.weights[right] > 0).sum(axis=0) >= 2
    among = scatter(rig, tracks, right)
    turns, apart, after = np.zeros((len(rig), 3)), np.zeros(len(rig)), np.zeros(len(rig))
    for v in sorted(wrong):
        shared = known & (tracks.weights[v] > 0)
        if shared.sum() < FEWEST_JOINTS:
            return None
        turns[v] = _turn(rig, tracks, v, points, shared)
    if not np.isfinite(among) or np.linalg.norm(turns, axis=-1).max() > FARTHEST:
        return None
    stand = turned(rig, turns)
    now = Tracks.of(stand, tracks.views, joints, SCORE)
    for v in sorted(wrong):
        shared = known & (tracks.weights[v] > 0)
        apart[v], after[v] = (np.median(_off(r, t, points)[shared, v]) for r, t in ((rig, tracks), (stand, now)))
    most = CURED * max(EXACT, among)
    mended = all(apart[v] >= max(APART, NEARER * after[v]) and after[v] <= most for v in wrong)
    return _Tried(wrong, turns, apart, after, mended, scatter(stand, now, range(len(rig))))


def _otherwise(rig: Rig, people: np.ndarray, numbers: np.ndarray, tracks: Tracks, found: _Tried) -> bool:
    """Whether one of the cameras as it is written down shows somebody else where the others see the person, or the
    person at another moment as well as turned."""
    right = [v for v in range(len(rig)) if v not in found.wrong]
    frames, count = people.shape[1], people.shape[3]
    points = meeting_points(tracks, right).reshape(frames, count, 3)
    known = (tracks.weights[right] > 0).sum(axis=0).reshape(frames, count) >= 2
    return any(
        _somebody_else(rig.subset([v]), people[v, :, 1:], points, known, float(found.apart[v]))
        or _another_moment(rig.subset([v]), people[v, :, 0], numbers, points, known) <= AS_WELL * found.after[v]
        for v in found.wrong
    )


def _somebody_else(camera: Rig, others: np.ndarray, points: np.ndarray, known: np.ndarray, apart: float) -> bool:
    """Whether other people of a camera, [F, P, J, 3], lie at world points [F, J, 3] in half of the frames."""
    fits = 0
    for seen, place, told in zip(others, points, known, strict=True):
        off = [beside(camera, one, place, told) for one in seen]
        fits += bool(off) and min(off) <= max(APART, apart / NEARER)
    return 2 * fits >= len(points)


def _another_moment(camera: Rig, seen: np.ndarray, numbers: np.ndarray, points: np.ndarray, known: np.ndarray) -> float:
    """Px of a picture of `SIDE` px by which joints [F, J, 3] of a camera lie beside world points [F, J, 3] some frames
    before or after, median, at best; infinite of a single frame."""
    if len(numbers) < 2:
        return np.inf
    velocity = np.gradient(points, numbers.astype(np.float64), axis=0)
    told = known & (np.gradient(known.astype(float), axis=0) == 0)
    moments = np.arange(-LATEST, LATEST + PART, PART)
    return min(beside(camera, seen, points + later * velocity, told) for later in moments)


def beside(camera: Rig, seen: np.ndarray, points: np.ndarray, known: np.ndarray) -> float:
    """Px of a picture of `SIDE` px from world points [..., 3] to joints [..., 3] of one camera, median of those that
    are known; infinite of none."""
    pixels, depth = project(camera, points)
    told = known & (seen[..., 2] >= SCORE) & (depth[..., 0] > NEAR)
    off = np.linalg.norm(pixels[..., 0, :] - seen[..., :2], axis=-1)[told]
    return float(np.median(off)) * SIDE / float(camera.size.max()) if len(off) else np.inf


def _turn(rig: Rig, tracks: Tracks, view: int, points: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """[3] rad in a camera's axes that brings world points [N, 3] to where it sees them, of those that are `shared` [N]:
    Wahba's problem, with robust weights."""
    rotation = rig.rotations[view]
    seen = tracks.directions[view, shared] @ rotation.T
    ahead = points[shared] - rig.centres[view]
    ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True) @ rotation.T
    px = rig.intrinsics[view, 0, 0] * SIDE / float(rig.size[view].max())
    weights, turn = tracks.weights[view, shared], np.eye(3)
    for _ in range(STEPS):
        off = px * np.linalg.norm(seen - ahead @ turn.T, axis=-1)
        heard = weights * np.minimum(1.0, SCATTER / np.maximum(off, 1e-9))
        turn = rigid((heard[:, None] * seen).T @ ahead, np.zeros(3))[:3, :3]
    return np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64).ravel()


def scatter(rig: Rig, tracks: Tracks, views: Iterable[int]) -> float:
    """Px by which joints of some cameras lie beside where the rays of at least three of these meet, median over those
    of a camera, mean over cameras; infinite where nothing is seen by three."""
    among = sorted(views)
    seen = tracks.weights[among] > 0
    told = seen & (seen.sum(axis=0) >= 3)
    off = _off(rig, tracks, meeting_points(tracks, among)).T[among]
    medians = [np.median(px[known]) for px, known in zip(off, told, strict=True) if known.any()]
    return float(np.mean(medians)) if medians else np.inf


def meeting_points(tracks: Tracks, views: Sequence[int]) -> np.ndarray:
    """[N, 3] where the rays of some cameras meet; anywhere of joints that fewer than two see."""
    weights = np.zeros_like(tracks.weights)
    weights[list(views)] = tracks.weights[list(views)]
    return meeting(tracks, weights.T)


def _off(rig: Rig, tracks: Tracks, points: np.ndarray) -> np.ndarray:
    """[N, S] px of a picture of `SIDE` px from world points to the joints of every camera."""
    return residuals(rig, tracks, points) / rig.size[tracks.views].max(axis=-1) * SIDE
