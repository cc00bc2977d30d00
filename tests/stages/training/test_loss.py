"""The parts of a step's loss: nothing to learn from costs nothing, and Gaussians of no share are the prior's."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from posegaussian.stages.network.losses import PoseFusion
from posegaussian.stages.network.model.network import PoseGaussianNetwork
from posegaussian.stages.network.model.presets import PRESETS
from posegaussian.stages.training.examples import Example, crop, whole
from posegaussian.stages.training.loss import (
    _prior,
    beats,
    depth_terms,
    draw,
    gaussian_maps,
    pose_terms,
    render_terms,
    together,
)
from tests.support.network_views import network
from tests.support.training_examples import ball, tiny

torch.set_num_threads(1)
CONFIG = tiny()


@pytest.fixture(scope="module")
def example() -> Example:
    return replace(crop(ball(), CONFIG, np.random.default_rng(1)), strange=False)


@pytest.fixture(scope="module")
def learner() -> PoseGaussianNetwork:
    return network().requires_grad_(True)


def test_nothing_to_learn_from_costs_0_with_a_gradient_of_0_even_of_one_iteration(
    learner: PoseGaussianNetwork, example: Example
) -> None:
    batch = together([example], torch.device("cpu"))
    found = depth_terms(learner(batch.views, 1), batch._replace(valid=torch.zeros_like(batch.valid)), CONFIG)
    assert float(found.detach()) == 0
    learner.zero_grad()
    found.backward()
    assert not any(bool(p.grad.any()) for p in learner.parameters() if p.grad is not None)
    known = depth_terms(learner(batch.views, 1), batch, CONFIG)
    assert float(known.detach()) > 0
    known.backward()
    gradients = {name: p.grad for name, p in learner.named_parameters() if p.grad is not None}
    assert all(torch.isfinite(g).all() for g in gradients.values())
    assert bool(gradients["image.stem.0.weight"].any())


def test_depth_costs_what_it_is_off_whatever_the_confidence(learner: PoseGaussianNetwork, example: Example) -> None:
    """mu-weighted steps, then trust, the learned and the blended disparity, each by its own weight."""
    batch = together([example], torch.device("cpu"))
    views, truth, valid, _ = batch
    with torch.no_grad():
        said = learner(views, 1)
    off = truth + 2
    exact = replace(
        said,
        disparities=[off],
        trust=torch.ones_like(off),
        change=torch.where(valid, off - views.start, 0),
        disparity=torch.where(valid, off, torch.nan),
    )
    won = beats(exact, batch)[valid]
    assert torch.equal(won, ((views.start - truth).abs() > 2)[valid])
    assert 0 < won.float().mean() < 1
    sure = torch.where(won, said.confidence[valid], 1 - said.confidence[valid])
    entropy = -CONFIG.confidence * float(sure.log().mean())
    assert float(depth_terms(exact, batch, CONFIG)) == pytest.approx(2 * (1 + 0.3 + 1 + 2) + entropy, rel=1e-4)


def test_views_that_do_not_fit_teach_no_depth_but_to_be_silent(learner: PoseGaussianNetwork, example: Example) -> None:
    """The same pair beside itself, shown as strange: the learned change has no gradient from it, and less confidence
    and smaller shares are better."""
    batch = together([replace(example, strange=True)], torch.device("cpu"))
    assert bool(batch.strange.all())
    learner.zero_grad()
    depth_terms(learner(batch.views, 1), batch, CONFIG).backward()
    confidence = learner.heads.last["confidence"].bias.grad
    assert confidence is not None
    assert all(float(of_one.sum()) > 0 for of_one in confidence.chunk(3))
    learner.zero_grad()
    said = learner(batch.views, 1)
    depth_terms(replace(said, disparity=said.disparity.detach()), batch, CONFIG).backward()
    change = learner.heads.last["disparity"].bias.grad
    assert change is None or not bool(change.any())


def test_pairs_are_put_together_where_start_and_truth_are_known(example: Example) -> None:
    views, truth, valid, _ = together([example, example], torch.device("cpu"))
    assert truth.shape == valid.shape == views.start.shape == (4, 1, 32, 32)
    assert torch.isfinite(truth).all()
    assert torch.equal(valid[:2], valid[2:])
    assert torch.equal(valid[:2], torch.isfinite(example.truth) & example.views.known)


def test_gaussians_of_no_share_are_the_priors(
    learner: PoseGaussianNetwork, example: Example, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegaussian.stages.network.model.heads.trust", lambda x: torch.zeros_like(x))
    monkeypatch.setattr("posegaussian.stages.network.model.network.trust", lambda x: torch.zeros_like(x))
    with torch.no_grad():
        said = learner(example.views, 1)
        for which in (0, 1):
            found = gaussian_maps(learner, said, example, which, which)
            start = example.views.start[which : which + 1]
            depth = torch.where(torch.isfinite(start), example.views.coding.only(which).depth(start.nan_to_num()), 0)
            prior, _ = _prior(example, which, depth[0, 0].numpy())
            assert torch.equal(found.depth, depth[0, 0])
            assert torch.equal(found.scale, prior.scale[0])
            assert torch.equal(found.normal, prior.normal[0])
            assert torch.equal(found.opacity, prior.opacity[0])
            assert bool((found.opacity > 0).any())


def test_true_depth_draws_the_held_out_picture_better_than_the_start(
    learner: PoseGaussianNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegaussian.stages.network.model.heads.trust", lambda x: torch.zeros_like(x))
    monkeypatch.setattr("posegaussian.stages.network.model.network.trust", lambda x: torch.zeros_like(x))
    errors = []
    for exact in (True, False):
        example = whole(ball(exact=exact), 0, CONFIG)
        with torch.no_grad():
            said = learner(example.views, 1)
            picture = draw(example, [gaussian_maps(learner, said, example, w, w) for w in (0, 1)], 1)
        assert picture.shape == example.seen.shape
        errors.append(float(((picture - example.seen).abs() * example.cover).mean()))
    assert errors[0] < 0.7 * errors[1]


def test_the_picture_moves_every_head_that_draws_and_no_confidence(
    learner: PoseGaussianNetwork, example: Example
) -> None:
    learner.zero_grad()
    render = render_terms(learner, learner(example.views, 1), [example], CONFIG)
    render.backward()
    for name, last in learner.heads.last.items():
        if name == "confidence":
            said, *shares = last.bias.grad.chunk(3)
            assert not bool(said.any()), "a probability is not taught by what looks well"
            assert all(bool(share.any()) for share in shares)
        assert torch.isfinite(last.bias.grad).all(), name
        assert bool(last.bias.grad.any()), name


def test_the_pose_term_is_0_without_a_pose_and_finite_without_joints(
    learner: PoseGaussianNetwork, example: Example
) -> None:
    fusion = PoseFusion(learner.preset.widths[-1], learner.preset.widths[-1])
    blind = replace(example.views, heatmaps=torch.zeros_like(example.views.heatmaps))
    with torch.no_grad():
        said = learner(blind, 1)
        assert torch.isfinite(pose_terms(fusion, said, blind, CONFIG))
        assert float(pose_terms(None, said, blind, CONFIG)) == 0
        assert float(pose_terms(fusion, replace(said, pose=None), blind, CONFIG)) == 0


def test_the_twist_of_a_quaternion_reaches_the_picture_and_learns_from_it(example: Example) -> None:
    torch.manual_seed(5)
    turning = PoseGaussianNetwork(replace(PRESETS["fast"], rotation_head="quaternion"))
    with torch.no_grad():
        for p in turning.last_layers():
            p.add_(0.05 * torch.randn_like(p))
        said = turning(together([example], torch.device("cpu")).views, 1)
        said.numbers["rotation"] = said.numbers["rotation"].detach().requires_grad_()
    maps = [gaussian_maps(turning, said, example, w, w) for w in (0, 1)]
    assert all(m.twist is not None for m in maps)
    wide = [replace(m, scale=m.scale * torch.tensor([3.0, 1.0, 1.0])[:, None, None]) for m in maps]
    turned, flat = draw(example, wide, 1), draw(example, [replace(m, twist=None) for m in wide], 1)
    assert float((turned - flat).detach().abs().max()) > 1e-3
    twists = [m.twist for m in maps]
    gradients = torch.autograd.grad(turned.sum(), twists)
    assert all(bool(g.any()) and bool(torch.isfinite(g).all()) for g in gradients)
