"""From the network's grid back to a view's own pixels: silence changes no bit, a true move gives the true depth,
whatever the pictures' shape."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

from posegaussian.stages.geometry.rectification import RectifiedPair
from posegaussian.stages.geometry.turning import turn_in_picture
from posegaussian.stages.network.inference import (
    FURTHEST,
    HEADS,
    NUMBERS,
    Learned,
    Looks,
    _merged,
    along,
    look,
    refined,
)
from posegaussian.stages.network.model.heads import trust
from posegaussian.stages.network.model.network import Prediction
from posegaussian.stages.network.model.pairs import PairViews, SourceView, windows
from posegaussian.stages.network.model.presets import LONELY_ANGLE, PRESETS, TRAINED_ANGLE, Preset
from posegaussian.storage.model.cameras import Rig
from tests.support.network_views import UPRIGHT, network, plane_depth, plane_disparity, source, two_cameras

torch.set_num_threads(1)
TRUE = np.array([1.0, 0.12, 0.16]), 0.07
"""Another plane than `UPRIGHT`, which is where depth starts: some px apart."""


class Oracle:
    """Stands for a network: says the same numbers and confidence everywhere; knows by how much the start is off."""

    preset: Preset = PRESETS["fast"]
    joints = 17
    device = torch.device("cpu")

    def __init__(self, moves: list[np.ndarray | float], confidence: float = 0.5) -> None:
        self.moves, self.confidence, self.seen = moves, confidence, 0

    def __call__(self, views: PairViews, iterations: int, only_last: bool = False, timer: object = None) -> Prediction:
        move = torch.stack(
            [torch.as_tensor(np.broadcast_to(m, views.start.shape[2:]).copy(), dtype=torch.float32) for m in self.moves]
        )[:, None]
        numbers = {
            name: torch.full((2, n, *views.start.shape[2:]), 0.1 * n)
            for name, n in (("scale", 3), ("rotation", 3), ("opacity", 2))
        }
        numbers["confidence"] = torch.full_like(views.start, np.log(self.confidence / (1 - self.confidence)))
        numbers["shares"] = torch.full((2, 2, *views.start.shape[2:]), 1.0)
        self.seen += 1
        return Prediction([], torch.ones_like(views.start), numbers, move, views.start + move, torch.zeros(1), None)


def shown(rig: Rig, plane: tuple[np.ndarray, float] = UPRIGHT) -> dict[int, SourceView]:
    return {v: source(rig, v, plane_depth(rig, v, plane)) for v in range(len(rig))}


def inner(depth: np.ndarray) -> np.ndarray:
    """Pixels whose surroundings have a depth, too."""
    return cv2.erode((depth > 0).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0


def moves(pair: RectifiedPair, views: dict[int, SourceView]) -> list[np.ndarray]:
    """By how much `TRUE` lies off `UPRIGHT` in both directions, px:
    linear in the pixel, so that interpolation is exact."""
    found = windows(pair, (views[pair.views[0]].depth > 0, views[pair.views[1]].depth > 0), Oracle.preset.stride)
    assert found is not None
    return [
        plane_disparity(pair, w, found[w], found[1 - w], TRUE)
        - plane_disparity(pair, w, found[w], found[1 - w], UPRIGHT)
        for w in (0, 1)
    ]


def test_what_says_nothing_changes_no_bit() -> None:
    depth = np.random.default_rng(0).uniform(0.5, 9, (40, 30)).astype(np.float32)
    depth[:5] = 0
    none = np.zeros((40, 30), np.float32)
    nothing = Learned(none, none, none, np.zeros((8, 40, 30), np.float32))
    assert refined(depth, nothing).tobytes() == depth.tobytes()


@pytest.mark.parametrize("said", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_changes_nothing(said: float) -> None:
    depth = np.array([[0.0, 2.0, 3.0]], np.float32)
    change = np.array([[said, said, 0.0]], np.float32)
    assert refined(depth, Learned(change, change, change, np.zeros((8, 1, 3), np.float32))).tobytes() == depth.tobytes()


def test_inverse_depth_is_changed_within_a_bound_and_no_surface_comes_up() -> None:
    depth = np.array([[0.0, 2.0, 2.0, 2.0]], np.float32)
    change = np.array([[0.3, 0.05, 30.0, -30.0]], np.float32)
    found = refined(depth, Learned(change, change, change, np.zeros((8, 1, 4), np.float32)))
    np.testing.assert_allclose(found[0], [0, 1 / 0.55, 2 / (1 + FURTHEST), 2 / (1 - FURTHEST)], rtol=1e-6)


@pytest.mark.parametrize("size", [(128, 128), (640, 480), (480, 640), (1280, 960)], ids=str)
def test_a_true_move_gives_the_true_depth_whatever_the_pictures_shape(size: tuple[int, int]) -> None:
    """To a thousandth of a px of disparity; the largest is looked at in half its size.
    D15: nothing takes width for height."""
    rig = two_cameras(size)
    views = shown(rig)
    looks = Looks.of(rig, (0, 1), 2)
    (pair,) = looks.pairs
    assert pair.scale == min(1, 640 / max(size))
    found = look(Oracle(moves(pair, views)), looks, views, 1, "float32")  # type: ignore[arg-type]
    assert set(found) == {0, 1}
    for v in (0, 1):
        start, said = views[v].depth, found[v]
        assert start.shape == said.confidence.shape == said.numbers.shape[1:] == size[::-1]
        true, sure = plane_depth(rig, v, TRUE, disc=np.inf), inner(start)
        before, after = (pair.sensitivity * np.abs(1 / d[sure] - 1 / true[sure]) for d in (start, refined(start, said)))
        assert sure.sum() > 0.1 * start.size
        assert before.max() > 0.5
        assert after.max() < 1e-3
        assert not said.inverse_depth[start == 0].any()
        assert not said.confidence[start == 0].any()


def test_confidence_share_and_numbers_arrive_as_they_were_said() -> None:
    rig = two_cameras()
    views = shown(rig)
    oracle = Oracle([0.0, 0.0], confidence=0.3)
    looks = Looks.of(rig, (0, 1), 1)
    found = look(oracle, looks, views, 1, "float32")[1]  # type: ignore[arg-type]
    turn = turn_in_picture(rig, looks.pairs[0], 1)
    assert 0.01 < abs(turn) < 0.1  # the pair's rows are not quite the picture's
    said = float(trust(torch.tensor(np.log(0.3 / 0.7))))
    np.testing.assert_allclose(found.confidence[found.confidence > 0], said, rtol=1e-5)
    np.testing.assert_allclose(found.share[found.share > 0], float(trust(torch.tensor(1.0))), rtol=1e-5)
    np.testing.assert_array_equal(found.share > 0, found.confidence > 0)
    assert found.numbers.shape[0] == NUMBERS
    expected = np.repeat([0.3, 0.3, 0.2], [3, 3, 2])
    expected[3:5] = 0.3 * (np.cos(turn) + np.sin(turn)), 0.3 * (np.cos(turn) - np.sin(turn))
    np.testing.assert_allclose(
        found.numbers[:, inner(views[1].depth)],
        np.broadcast_to(expected[:, None], (8, inner(views[1].depth).sum())),
        rtol=1e-5,
    )
    assert HEADS == ("scale", "rotation", "opacity")
    assert refined(views[1].depth, found).tobytes() == views[1].depth.tobytes()


def said_by_chance(shape: tuple[int, int] = (2, 3)) -> Learned:
    numbers = np.random.default_rng(0).normal(size=(NUMBERS, *shape)).astype(np.float32)
    everywhere = np.ones(shape, np.float32)
    return Learned(np.zeros(shape, np.float32), everywhere, everywhere, numbers)


def test_four_quarter_turns_are_none_and_two_turn_what_leans_a_normal_round() -> None:
    said = said_by_chance()
    half = along(along(said, np.pi / 2, 3), np.pi / 2, 3)
    np.testing.assert_allclose(half.numbers, said.numbers * np.array([1, 1, 1, -1, -1, 1, 1, 1])[:, None, None], 1e-5)
    np.testing.assert_allclose(along(along(half, np.pi / 2, 3), np.pi / 2, 3).numbers, said.numbers, rtol=1e-5)
    quarter = along(said, np.pi / 2, 3).numbers
    np.testing.assert_allclose(quarter[[1, 0]], said.numbers[[0, 1]], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("turn", [0.3, -1.2, 2.5])
def test_what_leans_a_normal_keeps_its_length_and_is_turned_back_by_the_opposite_turn(turn: float) -> None:
    said = said_by_chance()
    turned = along(said, turn, 3)
    np.testing.assert_allclose(*(np.hypot(*n.numbers[3:5]) for n in (turned, said)), rtol=1e-5)
    np.testing.assert_allclose(along(turned, -turn, 3).numbers[3:5], said.numbers[3:5], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(turned.numbers[:2].sum(axis=0), said.numbers[:2].sum(axis=0), rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(turned.numbers[5:], said.numbers[5:])


def test_what_pairs_say_is_averaged_by_their_confidence() -> None:
    a, b = (
        Learned(
            np.full((1, 3), x, np.float32),
            np.array(c, np.float32)[None],
            np.full((1, 3), 0.1 * x, np.float32),
            np.full((8, 1, 3), x, np.float32),
        )
        for x, c in ((1.0, [0.2, 0.5, 0.0]), (4.0, [0.6, 0.0, 0.0]))
    )
    both = _merged([a, b])
    np.testing.assert_allclose(both.inverse_depth[0], [3.25, 1, 0], rtol=1e-6)
    np.testing.assert_allclose(both.confidence[0], [0.5, 0.5, 0], rtol=1e-6)
    np.testing.assert_allclose(both.share[0], [0.325, 0.1, 0], rtol=1e-6)
    np.testing.assert_allclose(both.numbers[:, 0], np.broadcast_to([3.25, 1, 0], (8, 3)), rtol=1e-6)
    assert _merged([a]) is a
    swapped = _merged([b, a])
    assert np.array_equal(swapped.inverse_depth, both.inverse_depth)


def test_a_view_between_two_others_hears_both_pairs() -> None:
    rig = two_cameras(angles=(-24.0, 0.0, 24.0))
    looks = Looks.of(rig, (0, 1, 2), 1)
    assert [p.views for p in looks.pairs] == [(0, 1), (1, 2)]
    oracle = Oracle([1.0, 1.0])
    found = look(oracle, looks, shown(rig), 1, "float32")  # type: ignore[arg-type]
    assert oracle.seen == 2
    assert set(found) == {0, 1, 2}
    # of the first pair view 1 is the second view and of the second the first:
    # the same px mean opposite changes, which cancel
    sure = inner(shown(rig)[1].depth)
    assert np.abs(found[1].inverse_depth[sure]).max() < 0.2 * np.abs(found[0].inverse_depth).max()


def test_views_without_a_surface_or_without_a_neighbour_are_not_spoken_of() -> None:
    rig = two_cameras(angles=(-20.0, 4.0, 170.0))
    looks = Looks.of(rig, (0, 1, 2), 2)
    assert [p.views for p in looks.pairs] == [(0, 1)]
    views = shown(rig)
    assert set(look(Oracle([0.0, 0.0]), looks, views, 1, "float32")) == {0, 1}  # type: ignore[arg-type]
    views[1] = source(rig, 1, np.zeros((128, 128), np.float32))
    assert look(Oracle([0.0, 0.0]), looks, views, 1, "float32") == {}  # type: ignore[arg-type]
    assert Looks.of(rig, (0, 2), 2).pairs == ()


def test_a_view_that_has_no_pair_otherwise_is_shown_its_nearest_a_little_farther_off() -> None:
    """Else it alone keeps its analytic depth, where all others have the network's."""
    beyond, wider = TRAINED_ANGLE + 4, LONELY_ANGLE + 2
    lonely = two_cameras(angles=(-40.0, 0.0, beyond, beyond + 30 - 360))
    assert [p.views for p in Looks.of(lonely, (0, 1, 2), 2).pairs] == [(0, 1), (1, 2)]
    assert [p.views for p in Looks.of(lonely, (0, 1, 2, 3), 2).pairs] == [(0, 1), (2, 3)], "which has one has no other"
    assert [p.views for p in Looks.of(two_cameras(angles=(-40.0, 0.0, wider)), (0, 1, 2), 2).pairs] == [(0, 1)]


def test_a_network_is_asked_the_same_and_answers_finite() -> None:
    rig = two_cameras((64, 64))
    views = shown(rig)
    net = network()
    first, again = (look(net, Looks.of(rig, (0, 1), 2), views, 2, "bf16") for _ in range(2))
    for v in (0, 1):
        assert first[v].numbers.tobytes() == again[v].numbers.tobytes()
        depth = refined(views[v].depth, first[v])
        assert np.isfinite(depth).all()
        assert np.array_equal(depth > 0, views[v].depth > 0)
