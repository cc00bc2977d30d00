"""A view without a partner: its pair with nobody leaves its picture as it is, its depth comes back, and nobody else has
a say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from posegaussian.stages.network.inference import look_alone, refined
from posegaussian.stages.network.model.pairs import PairViews, single_view, window_around
from posegaussian.stages.network.single_view import ANGLE, beside, single_pair
from tests.support.network_views import network, plane_depth, random_views, source, two_cameras

RIG = two_cameras()


def test_the_pair_with_nobody_looks_as_the_view_does() -> None:
    """Same axes, a disparity of 0 at the subject, and the angle that is said."""
    pair = single_pair(RIG, 0, np.zeros(3))
    np.testing.assert_allclose(pair.rotation, RIG.rotations[0], atol=1e-12)
    distance = RIG.rotations[0, 2] @ (np.zeros(3) - RIG.centres[0])
    assert abs(pair.baseline) / distance == pytest.approx(np.tan(np.radians(ANGLE)))
    window = (10, 20, 64, 32)
    other = beside(pair, window)
    assert other[1:] == window[1:]
    shift = float(pair.disparity(np.array(distance))) - (window[0] - other[0])
    assert abs(shift) <= 0.5


def test_depth_comes_back_and_no_confidence_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    depth = plane_depth(RIG, 0)
    shown = source(RIG, 0, depth)
    pair = single_pair(RIG, 0, np.zeros(3))
    window = window_around(pair, depth > 0, 8)
    assert window is not None
    views = single_view(pair, shown, (window, beside(pair, window)))
    assert views.all_alone
    known = views.known
    back = views.coding.depth(torch.where(known, views.start, 0))[known]
    assert float((back - float(np.median(depth[depth > 0]))).abs().max()) < np.ptp(depth[depth > 0])
    monkeypatch.setattr("posegaussian.stages.network.model.network.trust", lambda x: torch.zeros_like(x))
    said = look_alone(network(alone=True), RIG, 0, shown, 2, "float32")
    assert said is not None
    np.testing.assert_array_equal(refined(depth, said), depth)
    nobody = replace(shown, depth=np.zeros_like(depth))
    assert look_alone(network(alone=True), RIG, 0, nobody, 2, "float32") is None


def test_the_other_direction_of_a_batch_has_no_say_in_a_view_alone() -> None:
    """And a single direction says what it says beside another one."""
    net, views = network(alone=True), random_views(1)
    alone = replace(views, alone=torch.tensor([True, True]))
    changed = replace(alone, color=torch.stack([alone.color[0], 1 - alone.color[1]]))
    mixed = replace(alone, alone=torch.tensor([True, False]))
    with torch.no_grad():
        first, other, beside_one = (net(v, 2).disparity[0] for v in (alone, changed, mixed))
        paired = net(views, 2).disparity[0]
    assert torch.equal(first.nan_to_num(), other.nan_to_num())
    torch.testing.assert_close(first, beside_one, rtol=0, atol=1e-4, equal_nan=True)
    assert not torch.equal(first.nan_to_num(), paired.nan_to_num())


def test_a_network_of_pairs_refuses_a_view_alone() -> None:
    views = replace(random_views(1), alone=torch.tensor([True, True]))
    with pytest.raises(ValueError, match="alone=True"):
        network()(views, 1)


def test_a_batch_keeps_who_is_alone_and_what_is_stabilised() -> None:
    plain, own = random_views(1), replace(random_views(1, seed=1), alone=torch.tensor([True, True]))
    steady = replace(own, stabilised=0.5 * own.heatmaps)
    both = PairViews.batch([plain, steady])
    assert both.alone is not None
    assert both.alone.tolist() == [False, False, True, True]
    assert torch.equal(both.of_pose, torch.cat([plain.heatmaps, 0.5 * own.heatmaps]))
    assert PairViews.batch([plain, plain]).alone is None
