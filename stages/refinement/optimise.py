"""One frame's Gaussians, optimised on its source pictures: pictures, loss, steps, and the judge that ends it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from posegaussian.stages.refinement.attributes import Learnt, Offsets, ViewGaussians
from posegaussian.stages.refinement.schedule import Schedule
from posegaussian.stages.rendering.lift import Lifted
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians, Rendering
from posegaussian.stages.splatting.rasterizer import rasterize

RATES = {"color": 0.0025, "scale": 0.02, "rotation": 0.01, "opacity": 0.1, "depth": 0.4}
"""Of Adam, in the units of the offsets. About half of them gained a fifth less in 50 steps (seeds 2 and 3); twice
those of normal, scale and colour overfit by 100."""
MEAN, SQUARE = 0.9, 0.999
"""Decay of the running means of a gradient and of its square."""
COVERAGE = 0.05
"""Weight of the difference in coverage beside that in colour."""
PICTURES = 2
"""Source pictures of a step; each moves the Gaussians."""
JUDGED_EVERY = 10
"""Steps from one judgement to the next."""
PATIENCE = 5
"""Judgements without a better one after which a frame is done."""


class Filmed(NamedTuple):
    """One source picture, as a rendering should look."""

    camera: Camera
    color: torch.Tensor  # [h, w, 3]
    """sRGB 0..1, premultiplied by the mask."""
    cover: torch.Tensor  # [h, w]
    """The mask, 0..1."""


@dataclass(frozen=True)
class OptimisedFrame:
    """How the optimisation of one frame went."""

    usable: int
    """Source views with a picture, a mask and Gaussians."""
    judge: int = -1
    """View that judged; -1: none, and nothing was done."""
    before: float = 0.0
    """Mean squared error of the judge's picture without refinement, sRGB 0..1."""
    after: float = 0.0
    """The same of what was kept; less than `before` where anything was."""
    step: int = 0
    """The step that was kept; 0 is the start."""
    warm: bool = False
    """Whether it started from what the frame before learnt."""
    masked: int = 0
    """Gradients that were not finite and were set to 0."""

    @property
    def refined(self) -> bool:
        """Whether the frame is another than it was."""
        return self.after < self.before

    def row(self) -> list[float]:
        """As `refinement/outcome` holds it."""
        return [self.usable, self.judge, self.before, self.after, self.step, self.warm, self.masked]


class _Adam:
    """Adam for the offsets of one view, in numpy: torch's own may round by an element's place in the array, which
    threads share out."""

    def __init__(self) -> None:
        self.mean: Offsets = {}
        self.square: Offsets = {}
        self.count = 0
        self.masked = 0

    def step(self, gaussians: ViewGaussians) -> None:
        """One step along the gradients, which are used up; one that is not finite counts as 0."""
        self.count += 1
        for name, values in gaussians.arrays().items():
            tensor = gaussians.offsets[name]
            gradient, tensor.grad = tensor.grad, None
            if gradient is None:
                continue
            g = gradient.numpy()
            bad = ~np.isfinite(g)
            if bad.any():
                self.masked += int(bad.sum())
                g = np.where(bad, np.float32(0), g)
            mean, square = (kept.setdefault(name, np.zeros_like(g)) for kept in (self.mean, self.square))
            mean += np.float32(1 - MEAN) * (g - mean)
            square += np.float32(1 - SQUARE) * (g * g - square)
            size = np.sqrt(square / np.float32(1 - SQUARE**self.count))
            ahead = np.isfinite(size) & (size > 0)
            values -= np.float32(RATES[name] / (1 - MEAN**self.count)) * np.divide(
                mean, size, out=np.zeros_like(mean), where=ahead
            )
        gaussians.confine()


def draw(parts: Sequence[Gaussians], camera: Camera) -> Rendering:
    """The picture of some views' Gaussians together."""
    return rasterize(Gaussians.concatenate(list(parts)), [camera])


def loss(rendered: Rendering, filmed: Filmed) -> torch.Tensor:
    """Sum of w (mean_rgb |color - picture| + COVERAGE |alpha - mask|) over the pixels, all premultiplied.

    w is 1 beside the person, where all should be empty, and the rendered alpha, as a constant, on the person: what no
    depth map holds is a hole, and Gaussians around it that grow to fill it in one picture are wrong in every other.
    """
    alpha = rendered.alpha[0]
    difference = (rendered.color[0] - filmed.color).abs()
    error = (difference[..., 0] + difference[..., 1] + difference[..., 2]) / 3 + COVERAGE * (alpha - filmed.cover).abs()
    return (error * torch.where(filmed.cover > 0, alpha.detach(), 1.0)).sum()


def distance(rendered: Rendering, filmed: Filmed) -> float:
    """Mean squared error of a picture; summed by numpy, whose order does not depend on threads."""
    return float(np.mean(np.square(rendered.color[0].numpy() - filmed.color.numpy(), dtype=np.float64)))


def unrefined(lifted: Mapping[int, Lifted], plan: Schedule, filmed: Filmed) -> float:
    """Error of the judge's picture as rendering draws it without refinement: from its neighbours, weighted."""
    parts = []
    for view, weight in plan.neighbours:
        seen = lifted[view].seen_from(filmed.camera)
        parts.append(replace(seen, opacity=seen.opacity * weight))
    return distance(draw(parts, filmed.camera), filmed)


def judged(gaussians: Mapping[int, ViewGaussians], plan: Schedule, filmed: Filmed) -> float:
    """Error of the judge's picture from all Gaussians but its own view's."""
    with torch.no_grad():
        return distance(draw([g.gaussians() for v, g in gaussians.items() if v != plan.judge], filmed.camera), filmed)


def optimise(
    gaussians: Mapping[int, ViewGaussians],
    filmed: Mapping[int, Filmed],
    plan: Schedule,
    steps: int,
    before: Mapping[int, Learnt],
    error: float,
) -> OptimisedFrame:
    """Change the offsets of a frame's Gaussians, by view, to those of the best judged step with less than `error`, if
    there is one.

    The start is what the frame `before` learnt where the judge finds that better. Deterministic: equal arguments give
    equal bits on any number of threads.
    """
    judge = filmed[plan.judge]
    warm = bool(before) and _start(gaussians, plan, judge, before)
    best, at, kept = error, 0, None
    if warm and (found := judged(gaussians, plan, judge)) < best:
        best, kept = found, {v: g.keep() for v, g in gaussians.items()}
    walks = {v: _Adam() for v in gaussians}
    for step in range(1, steps + 1):
        for k in range(PICTURES):
            picture = filmed[plan.pupils[((step - 1) * PICTURES + k) % len(plan.pupils)]]
            loss(draw([g.gaussians() for g in gaussians.values()], picture.camera), picture).backward()
            for view, g in gaussians.items():
                walks[view].step(g)
        if step % JUDGED_EVERY == 0 or step == steps:
            found = judged(gaussians, plan, judge)
            if found < best:
                best, at, kept = found, step, {v: g.keep() for v, g in gaussians.items()}
            elif step - at >= PATIENCE * JUDGED_EVERY:
                break
    for view, g in gaussians.items():
        if kept is not None:
            g.put(kept[view])
    return OptimisedFrame(len(gaussians), plan.judge, error, best, at, warm, sum(w.masked for w in walks.values()))


def _start(gaussians: Mapping[int, ViewGaussians], plan: Schedule, judge: Filmed, before: Mapping[int, Learnt]) -> bool:
    """Start from what another frame learnt; back again where the judge finds that no better."""
    cold = judged(gaussians, plan, judge)
    for view, learnt in before.items():
        if view in gaussians:
            gaussians[view].start_from(learnt)
    if judged(gaussians, plan, judge) < cold:
        return True
    for g in gaussians.values():
        g.put({name: np.zeros_like(a) for name, a in g.arrays().items()})
    return False
