"""A tiny training on the CPU: it learns, goes on bit-exactly, and a step that is no number leaves no trace."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch

from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.contract import Frame
from posegaussian.stages.training.examples import drawn, frames_of_step
from posegaussian.stages.training.loss import depth_terms, together
from posegaussian.stages.training.trainer import NetworkTrainer
from tests.support.training_examples import ball, tiny

torch.set_num_threads(1)
LEARNT = 0.95
"""Share of its first loss that a fixed batch may at most cost after `STEPS` steps. Measured 0.75 of pairs and 0.92 with
third views, which is soon all: the ball's rim stays far off, and pictures are spoilt."""
STEPS = 20


@pytest.fixture(scope="module")
def frames() -> dict[int, Frame]:
    return {0: ball()}


def cost(trainer: NetworkTrainer, config: TrainingConfig, frames: Mapping[int, Frame]) -> float:
    """Of depth, over four pairs that no step draws, as the averaged weights have it."""
    found = []
    for step in range(10_000, 10_004):
        batch = together(
            drawn(config, step, dict.fromkeys(frames_of_step(config, step), frames[0]))[0], torch.device("cpu")
        )
        with torch.no_grad():
            found.append(float(depth_terms(trainer.averaged(batch.views, 2), batch, config)))
    return float(np.mean(found))


def numbers(trainer: NetworkTrainer) -> list[np.ndarray]:
    """Every number that a training holds."""
    found: list[np.ndarray] = []

    def collect(value: Any) -> None:
        if isinstance(value, torch.Tensor):
            found.append(value.detach().clone().numpy())
        elif isinstance(value, Mapping):
            for v in value.values():
                collect(v)
        elif isinstance(value, list | tuple):
            for v in value:
                collect(v)

    collect(trainer.state())
    return found


def same(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return len(a) == len(b) and all(x.tobytes() == y.tobytes() for x, y in zip(a, b, strict=True))


def test_training_lowers_the_loss(frames: dict[int, Frame]) -> None:
    config = tiny(learning_rate=2e-3)
    trainer = NetworkTrainer(config)
    before = cost(trainer, config, frames)
    log = [trainer.advance(frames) for _ in range(STEPS)]
    assert cost(trainer, config, frames) < LEARNT * before
    assert trainer.step == STEPS
    assert all(np.isfinite(list(row.values())).all() for row in log)
    assert {"loss", "epe", "epe start", "skipped", "rate"} <= set(log[0])
    assert log[-1]["skipped"] == 0
    found = trainer.validate(frames)
    assert found["epe"] < found["epe start"]
    assert trainer.weights().keys() == trainer.network.state_dict().keys()


def test_cameras_above_each_other_are_trained_on_through_both_phases() -> None:
    """Their pictures are turned by a quarter, and gradients find their way back."""
    config, frames = tiny(depth_steps=2, joint_steps=2), {0: ball(stacked=True)}
    batch = drawn(config, 0, dict.fromkeys(frames_of_step(config, 0), frames[0]))[0]
    assert all(t % 2 for t in together(batch, torch.device("cpu")).views.turned.turns)
    trainer = NetworkTrainer(config)
    log = [trainer.advance(frames) for _ in range(4)]
    assert [row["skipped"] for row in log] == [0] * 4
    assert [row["render"] > 0 for row in log] == [False, False, True, True]


def test_training_with_third_views_lowers_the_loss() -> None:
    config, frames = tiny(learning_rate=2e-3, further_views=True, batch=2), {0: ball(angles=(-15.0, 15.0, 40.0))}
    trainer = NetworkTrainer(config)
    weight = trainer.network.refinement.update.motion.correlation[0].weight
    before, taps = cost(trainer, config, frames), weight[:, -2 * 9 :].detach().clone()
    log = [trainer.advance(frames) for _ in range(STEPS)]
    assert cost(trainer, config, frames) < LEARNT * before
    assert all(np.isfinite(list(row.values())).all() for row in log)
    assert log[-1]["skipped"] == 0
    assert (weight[:, -2 * 9 :] != taps).any()  # what reads the third view learns
    assert np.isfinite(list(trainer.validate(frames).values())).all()


def test_it_goes_on_bit_exactly_from_a_state_through_both_phases(frames: dict[int, Frame]) -> None:
    config = tiny(depth_steps=2, joint_steps=2)
    whole = NetworkTrainer(config)
    for step in range(4):
        if step == 1:
            kept = copy.deepcopy(whole.state())
        whole.advance(frames)
    torch.manual_seed(123)  # whatever the process did before does not matter
    resumed = NetworkTrainer(config)
    resumed.restore(kept)
    assert resumed.step == 1
    resumed.validate(frames)  # looking changes nothing
    log = [resumed.advance(frames) for _ in range(3)]
    assert [row["render"] > 0 for row in log] == [False, True, True]
    assert same(numbers(resumed), numbers(whole))


def test_first_weights_follow_from_the_seed() -> None:
    config = tiny()
    first, again, other = NetworkTrainer(config), NetworkTrainer(config), NetworkTrainer(tiny(seed=1))
    assert same(numbers(first), numbers(again))
    assert not same(numbers(first), numbers(other))


def test_a_frame_that_is_no_number_skips_its_step_and_changes_no_weight(frames: dict[int, Frame]) -> None:
    """L10."""
    spoilt = {0: {**frames[0], "confidence": np.full_like(frames[0]["confidence"], np.nan)}}
    trainer = NetworkTrainer(tiny())
    trainer.advance(frames)
    before = numbers(trainer)
    row = trainer.advance(spoilt)
    assert not np.isfinite(row["loss"])
    assert (row["skipped"], trainer.skipped, trainer.step) == (1, 1, 2)
    assert same(numbers(trainer), before)
    after = trainer.advance(frames)
    assert np.isfinite(after["loss"])
    assert np.isfinite(after["gradient"])
    assert after["skipped"] == 1
    assert not same(numbers(trainer), before)
    assert all(np.isfinite(n).all() for n in numbers(trainer))
