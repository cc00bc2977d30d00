"""Records D5, L5, L6 and L8-L10: losses, heads, features and steps of the network."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from posegaussian.stages.network.losses import sequence_loss
from posegaussian.stages.network.model.encoders import image_encoder
from posegaussian.stages.network.model.heads import Heads, Prior, blend_quaternions, growth, limited, trust
from posegaussian.stages.network.model.presets import PRESETS, Normalisation
from posegaussian.stages.training.trainer import NetworkTrainer
from tests.hard_cases.catalogue import Case, apart, worst
from tests.support.training_examples import ball, tiny

FAR = (-1e3, -50.0, -0.5, 0.0, 0.5, 50.0, 1e3)


def naive_sequence() -> float:
    """Weights 0.9^(15 / (T - 1) (T - t)), as two published systems have them, of one prediction that is 2 px off."""
    count = 1
    return abs(sum((0.9 ** (15 / (count - 1))) ** (count - 1 - t) * 2.0 for t in range(count)) - 2)


def sequence_error() -> float:
    truth = torch.zeros(1, 1, 2, 2)
    return abs(float(sequence_loss([truth + 2], truth, torch.ones_like(truth))) - 2)


def slope(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    return torch.autograd.grad(y.sum(), x)[0].detach()


def naive_dead_heads() -> float:
    """Share of numbers whose slope is under 1e-9: softplus of beta 100, at most 0.01."""
    x = torch.tensor(FAR, requires_grad=True)
    return float((slope(x, torch.nn.functional.softplus(x, beta=100).clamp(max=0.01)) < 1e-9).double().mean())


def dead_heads() -> float:
    x = torch.tensor(FAR, requires_grad=True)
    return float((slope(x, growth(x)) < 1e-9).double().mean())


def turned() -> tuple[torch.Tensor, torch.Tensor]:
    """A quaternion, and the same rotation with the other sign but for a thousandth."""
    q = torch.nn.functional.normalize(torch.tensor([0.5, -0.1, 0.7, 0.2]).double(), dim=0).reshape(1, 4, 1, 1)
    near = torch.nn.functional.normalize(
        q + 1e-3 * torch.tensor([0.1, 0.9, 0.2, -0.4]).double().reshape(1, 4, 1, 1), dim=1
    )
    return q, -near


def off(q: torch.Tensor, blended: torch.Tensor) -> float:
    """Degrees between two rotations."""
    return math.degrees(2 * math.acos(min(1.0, abs(float((q * blended).sum())))))


def naive_blend() -> float:
    q, other = turned()
    return off(q, torch.nn.functional.normalize(0.5 * q + 0.5 * other, dim=1))


def blend_error() -> float:
    q, other = turned()
    return off(q, blend_quaternions(q, other, torch.full((1, 1, 1, 1), 0.5, dtype=torch.float64)))


def dead_confidence(bounded: bool) -> float:
    """Share of logits without any slope."""
    x = torch.tensor(FAR, requires_grad=True)
    return float((slope(x, trust(x) if bounded else torch.sigmoid(x)) < 1e-9).double().mean())


DISPARITIES = torch.tensor([64.3, 200.7, 511.2]).reshape(1, 1, 1, 3)


def kept_disparity() -> float:
    """Px by which heads within bfloat16 autocast miss the prior's disparity, and, where they say 0.3, what that is
    beside it in float32."""
    prior = Prior(
        DISPARITIES,
        torch.full((1, 3, 1, 3), 0.002),
        torch.tensor([0.0, 0, -1]).reshape(1, 3, 1, 1).expand(1, 3, 1, 3),
        torch.full((1, 2, 1, 3), 0.9),
    )
    found = []
    for said in (0.0, 0.3):
        heads = Heads(4)
        torch.nn.init.constant_(heads.last["disparity"].bias, said)  # type: ignore[arg-type]
        with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
            out = heads(torch.ones(1, 4, 1, 3, dtype=torch.bfloat16), prior, -prior.normal)
        found.append(apart(out.disparity, DISPARITIES + limited(torch.tensor(said), heads.reach)))
    return worst(found)


def told_by_neighbours(normalisation: Normalisation, training: bool) -> float:
    """By how much the features of a picture change with the other one of its batch, of the largest."""
    g = torch.Generator().manual_seed(0)
    picture, light, dark = (
        torch.rand(1, 3, 32, 32, generator=g),
        torch.rand(1, 3, 32, 32, generator=g),
        0.1 * torch.rand(1, 3, 32, 32, generator=g),
    )
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(0)
        encoder = image_encoder(replace(PRESETS["fast"], normalisation=normalisation)).train(training)
        one, other = (encoder(torch.cat([picture, beside]))[-1][0] for beside in (light, dark))
    return apart(one / one.abs().max(), other / one.abs().max())


def naive_bad_batch() -> float:
    """Share of the weights that are not finite after one step."""
    line = torch.nn.Linear(8, 1)
    optimiser = torch.optim.AdamW(line.parameters())
    (line(torch.ones(1, 8)) * math.nan).sum().backward()
    optimiser.step()
    return float((~torch.isfinite(line.weight)).double().mean())


def bad_batch() -> tuple[float, NetworkTrainer]:
    """Largest change of a weight, averaged or not, by a step of a frame whose confidence is no number;
    the trainer after it."""
    trainer = NetworkTrainer(tiny())
    before = [p.detach().clone() for p in (*trainer.learnt, *trainer.averaged.parameters())]
    frame = ball()
    trainer.advance({0: {**frame, "confidence": np.full_like(frame["confidence"], np.nan)}})
    return (
        worst(apart(a, b) for a, b in zip(before, (*trainer.learnt, *trainer.averaged.parameters()), strict=True)),
        trainer,
    )


CASES = (
    Case(
        "D5",
        "one iteration of the matching network",
        "its weight's exponent is divided by T - 1 = 0",
        "px",
        naive_sequence,
        sequence_error,
        0.0,
        "mu^(T - t): no division",
    ),
    Case(
        "L5",
        "heads far from their range",
        "a softplus with a cap has no slope on either side",
        "of numbers without a slope",
        naive_dead_heads,
        dead_heads,
        0.0,
        "slopes fall like 1/x^2, to 1e-7 of a footprint at 1000",
    ),
    Case(
        "L6",
        "quaternions of two hemispheres, blended",
        "q and -q are one rotation, and their mean is none",
        "degrees",
        naive_blend,
        blend_error,
        0.2,
        "the two rotations are 0.1 degrees apart",
    ),
    Case(
        "L6b",
        "a confidence that saturates",
        "the sigmoid's slope is 0 in float32",
        "of logits without a slope",
        lambda: dead_confidence(False),
        lambda: dead_confidence(True),
        0.0,
        "logits stay within -6..6, with slopes that fall like 1/x^2",
    ),
    Case(
        "L8",
        "disparities within mixed precision",
        "bfloat16 has steps of 2 px from 256 on",
        "px",
        lambda: worst([apart(DISPARITIES.bfloat16().float(), DISPARITIES)]),
        kept_disparity,
        0.0,
        "heads and disparities are float32, whatever surrounds them",
    ),
    Case(
        "L9",
        "batch normalisation of two pictures",
        "the features of one tell of the other, and differ from those it has alone",
        "of the largest",
        lambda: told_by_neighbours("batch", True),
        lambda: told_by_neighbours("group", True),
        0.0,
        "groups of channels of each picture by itself; the variant with batches is frozen when it is used",
    ),
    Case(
        "L10",
        "one batch that is not a number",
        "every weight is none after it, and stays so",
        "of the weights",
        naive_bad_batch,
        lambda: bad_batch()[0],
        0.0,
        "the step is skipped and counted: not a bit of weights, average or optimiser changes",
    ),
)
