"""Who is who: whatever the order of detections and the cut of the footage, people stay themselves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.following.assignment import matched
from posegaussian.stages.following.everybody import Everybody
from posegaussian.stages.following.nearness import FLIPS
from posegaussian.storage.model.cameras import Rig
from tests.support.walking_skeleton import SKELETON, pixels, ring

RATE = 25.0
RIG = ring(5, size=512, focal=0.9, radius=3.5)
People = list[list[np.ndarray]]
"""[frame][view] -> [P, 17, 3]."""


def at(paths: Sequence[np.ndarray]) -> list[np.ndarray]:
    """[F, 17, 3] of skeletons that stand upright at places [F, 2] each; the second one is shorter."""
    return [
        np.concatenate([SKELETON[None, :, :2] + p[:, None], np.repeat(SKELETON[None, :, 2:], len(p), 0)], axis=2)
        * ([1, 1, 1.0 - 0.04 * n])
        for n, p in enumerate(paths)
    ]


def crossing(frames: int = 30) -> list[np.ndarray]:
    """Two people who pass each other at half an arm's length."""
    x = np.linspace(-1.2, 1.2, frames)
    return at([np.stack([x, 0 * x - 0.2], axis=1), np.stack([-x, 0 * x + 0.2], axis=1)])


def filmed(bodies: list[np.ndarray], rig: Rig = RIG, noise: float = 1.5, seed: int = 0) -> tuple[People, np.ndarray]:
    """What a detector gives, in an order of its own in every picture, and whom each detection is of [F, V, P]."""
    random = np.random.default_rng(seed)
    seen = np.stack([pixels(rig, b) for b in bodies], axis=2)  # [F, V, P, 17, 3]
    seen[..., :2] += random.normal(0, noise, seen[..., :2].shape)
    seen[..., 2] = random.uniform(0.6, 0.95, seen[..., 2].shape)
    order = np.argsort(random.random(seen.shape[:3]), axis=2)
    people = [[seen[f, v, order[f, v]] for v in range(len(rig))] for f in range(len(seen))]
    return people, order


def follow(people: People, rig: Rig = RIG, looks: dict[tuple[int, int], np.ndarray] | None = None) -> Everybody:
    times = np.arange(len(people)) / RATE
    found = Everybody.of(rig, ((f, float(times[f]), p) for f, p in enumerate(people)), times, gap=0.5)
    found.settle(looks or {}, 0.5)
    return found


def said(found: Everybody, order: np.ndarray) -> np.ndarray:
    """[F, V, bodies] who each body is said to be; -1 where it was not found."""
    out = np.full(order.shape, -1)
    for f, v in np.ndindex(order.shape[:2]):
        out[f, v, order[f, v]] = found.numbers[f, v, : order.shape[2]]
    return out


@pytest.mark.parametrize("views", [2, 3, 5])
def test_people_who_pass_each_other_stay_themselves_in_every_frame_and_view(views: int) -> None:
    rig = ring(views, size=512, focal=0.9, radius=3.5, degrees=360.0 if views > 2 else 120.0)
    people, order = filmed(crossing(), rig)
    who = said(follow(people, rig), order)
    assert {tuple(np.unique(who[..., b])) for b in range(2)} == {(0,), (1,)}


def test_the_order_of_detections_in_a_picture_changes_nothing() -> None:
    people, order = filmed(crossing())
    found = follow(people)
    random = np.random.default_rng(5)
    turned = [[random.permutation(len(p)) for p in views] for views in people]
    again = follow([[p[t] for p, t in zip(*fv, strict=True)] for fv in zip(people, turned, strict=True)])
    for f, v in np.ndindex(order.shape[:2]):
        np.testing.assert_array_equal(again.numbers[f, v, :2], found.numbers[f, v, turned[f][v]])
    assert [[f for f, _ in p] for p in again.places.values()] == [[f for f, _ in p] for p in found.places.values()]
    for n in found.places:
        np.testing.assert_array_equal(
            np.stack([m for _, m in again.places[n]]), np.stack([m for _, m in found.places[n]])
        )


def test_a_camera_less_or_lost_detections_leave_people_themselves() -> None:
    people, order = filmed(crossing())
    fewer = [[p if v != 2 else p[:0] for v, p in enumerate(views)] for views in people]
    random = np.random.default_rng(2)
    kept = random.random(order.shape) > 0.3
    lost = [[p[kept[f, v]] for v, p in enumerate(views)] for f, views in enumerate(people)]
    who = said(follow(fewer), order)[:, [0, 1, 3, 4]]
    assert {tuple(np.unique(who[..., b])) for b in range(2)} == {(0,), (1,)}
    found = follow(lost)
    told = np.full(order.shape, -2)
    for f, v in np.ndindex(order.shape[:2]):
        told[f, v, order[f, v][kept[f, v]]] = found.numbers[f, v, : int(kept[f, v].sum())]
    names = [set(told[..., b].ravel()) - {-2, -1} for b in range(2)]
    assert names in ([{0}, {1}], [{1}, {0}])
    assert (told == -1).sum() <= 0.05 * kept.sum()  # a detection of whom no other view saw, at the very beginning


def test_a_view_that_mirrors_somebody_still_sees_them() -> None:
    people, order = filmed(crossing())
    mirrored = [[p[:, FLIPS] if v == 1 else p for v, p in enumerate(views)] for views in people]
    who = said(follow(mirrored), order)
    assert {tuple(np.unique(who[..., b])) for b in range(2)} == {(0,), (1,)}


def test_a_wrong_view_does_not_make_people_of_its_own() -> None:
    people, order = filmed(crossing())
    wrong = [[p + np.array([150.0, 40.0, 0.0]) if v == 1 else p for v, p in enumerate(views)] for views in people]
    found = follow(wrong)
    who = said(found, order)[:, [0, 2, 3, 4]]
    assert {tuple(np.unique(who[..., b])) for b in range(2)} == {(0,), (1,)}
    assert len(found.places) == 2


def looks_of(people: People, order: Any, colors: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """What looking at the wanted pictures gives where body b has the looks colors[b]; order[frame][view]: whom each
    detection is of."""
    times = np.arange(len(people)) / RATE
    raw = Everybody.of(RIG, ((f, float(times[f]), p) for f, p in enumerate(people)), times, gap=0.5)
    taken: dict[tuple[int, int], list[np.ndarray]] = {}
    for v, frames in raw.look_at().items():
        for f, wanted in frames.items():
            for index, number, piece in wanted:
                taken.setdefault((number, piece), []).append(colors[order[f][v][index]])
    return {k: np.mean(x, axis=0) for k, x in taken.items()}


def two_looks() -> np.ndarray:
    """[2 people, 2 parts, 192] different clothes."""
    out = np.zeros((2, 2, 192))
    out[0, :, 5], out[1, :, 100] = 1.0, 1.0
    return out


def test_who_leaves_and_comes_back_is_the_same_if_their_looks_say_so() -> None:
    frames, away = 36, range(10, 26)  # longer than a gap that is bridged unseen
    people, order = filmed(crossing(frames))
    gone = [[p[order[f, v] != 1] if f in away else p for v, p in enumerate(views)] for f, views in enumerate(people)]
    short = [[o[o != 1] if f in away else o for o in order[f]] for f in range(frames)]
    looks = {"same": looks_of(gone, short, two_looks()), "unknown": looks_of(gone, short, np.zeros((2, 2, 192)))}
    assert len(follow(gone, looks=looks["same"]).places) == 2
    assert len(follow(gone, looks=looks["unknown"]).places) == 3


@pytest.mark.parametrize(("alike", "company", "same"), [(0.6, False, True), (0.6, True, False), (0.4, False, False)])
def test_who_comes_back_changed_is_the_same_only_where_nobody_else_was_there(
    alike: float, company: bool, same: bool
) -> None:
    """Of looks that are alike by so much: of somebody who turned meanwhile, say."""
    frames, away = 36, range(10, 26)  # longer than a gap that is bridged unseen
    people, order = filmed(crossing(frames))
    shown = [[o if company else o[o == 1] for o in views] for views in order]
    shown = [[o[o != 1] if f in away else o for o in views] for f, views in enumerate(shown)]
    seen = [
        [p[np.isin(o, kept)] for p, o, kept in zip(*x, strict=True)] for x in zip(people, order, shown, strict=True)
    ]
    found = follow(seen)
    looks: dict[tuple[int, int], np.ndarray] = {}
    for v, wanted in found.look_at().items():
        for f, those in wanted.items():
            for index, number, piece in those:
                looks[number, piece] = two_looks()[shown[f][v][index]].copy()
                if shown[f][v][index] == 1 and f >= away.stop:
                    looks[number, piece] *= alike**2  # the affinity is a sum of roots of products
                    looks[number, piece][:, 50] = 1 - alike**2
    found.settle(looks, 0.5)
    assert len(found.places) == 1 + company + (not same)


def test_people_exchanged_while_too_close_are_put_right_by_their_looks() -> None:
    """Filmed so rarely that, where they meet, positions tell the wrong thing."""
    frames = 16
    x = np.abs(np.linspace(-1.2, 1.2, frames)) + 0.1
    touching = at([np.stack([-x, 0 * x], axis=1), np.stack([x, 0 * x], axis=1)])  # they seem to come and go back
    order_of = [0, 1]
    people, order = filmed(touching)
    swapped = order.copy()
    swapped[frames // 2 :] = 1 - swapped[frames // 2 :]  # but it was the other one who went on
    plain = said(follow(people), swapped)
    right = said(follow(people, looks=looks_of(people, swapped, two_looks())), swapped)
    assert {tuple(np.unique(plain[..., b])) for b in order_of} == {(0, 1)}
    clear = np.delete(right, [frames // 2 - 1, frames // 2], axis=0)  # the moment itself is anybody's
    assert {tuple(np.unique(clear[..., b])) for b in order_of} == {(0,), (1,)}


def test_a_single_camera_follows_in_its_picture() -> None:
    rig = RIG.subset([0])
    y = np.linspace(-0.8, -0.4, 20)
    bodies = at([np.stack([0 * y, y], axis=1), np.stack([0 * y, y + 1.1], axis=1)])
    people, order = filmed(bodies, rig)
    who = said(follow(people, rig), order)
    assert {tuple(np.unique(who[..., b])) for b in range(2)} == {(0,), (1,)}


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (4, 2), (4, 4)])
def test_an_assignment_is_the_best_of_all(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(sum(shape))
    for _ in range(30):
        off, limit = random.random(shape), float(random.choice([0.4, 2.0]))
        found = matched(off, limit)
        assert len({i for i, _ in found}) == len({j for _, j in found}) == len(found)

        wide = off if shape[0] <= shape[1] else off.T
        givings = [
            [(i, j) for i, j in enumerate(p) if wide[i, j] <= limit]
            for p in permutations(range(wide.shape[1]), wide.shape[0])
        ]
        best = min((-len(pairs), sum(wide[i, j] for i, j in pairs)) for pairs in givings)
        assert (-len(found), pytest.approx(sum(off[i, j] for i, j in found))) == best


def sparse(seconds: float, frames: int = 8) -> tuple[People, np.ndarray, np.ndarray]:
    """Two people in frames `seconds` apart, who change places from each to the next; and the times of the frames."""
    x = 0.5 * (-1.0) ** np.arange(frames)
    people, order = filmed(at([np.stack([x, 0 * x], axis=1), np.stack([-x, 0 * x], axis=1)]))
    return people, order, seconds * np.arange(frames)


def test_frames_that_lie_seconds_apart_show_the_same_person() -> None:
    people, order, times = sparse(1.3)
    alone = [[p[o == 0] for p, o in zip(*fv, strict=True)] for fv in zip(people, order, strict=True)]
    found = Everybody.of(RIG, ((f, float(times[f]), p) for f, p in enumerate(alone)), times, gap=0.5)
    found.settle({}, 0.5)
    assert (found.numbers[..., 0] == 0).all()
    assert len(found.places) == 1


def test_people_who_change_places_between_frames_that_lie_apart_are_told_apart_by_their_looks() -> None:
    people, order, times = sparse(1.3)
    found = Everybody.of(RIG, ((f, float(times[f]), p) for f, p in enumerate(people)), times, gap=0.5)
    taken: dict[tuple[int, int], np.ndarray] = {}
    for v, frames in found.look_at().items():
        for f, wanted in frames.items():
            for index, number, piece in wanted:
                taken[number, piece] = two_looks()[order[f, v, index]]
    found.settle(taken, 0.5)
    who = said(found, order)
    assert {tuple(np.unique(who[..., b])) for b in range(2)} == {(0,), (1,)}
