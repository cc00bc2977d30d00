"""One frame's Gaussians, optimised on its source pictures: pictures, loss, steps, and the judge that ends it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from stages.refinement.attributes import Learnt, Offsets, ViewGaussians
from stages.refinement.schedule import Lesson, Schedule
from stages.rendering.rasterizer import rasterize
from stages.rendering.scene import Camera, Gaussians, Rendering

RATES = {"color": 0.002, "scale": 0.05, "rotation": 0.003, "opacity": 0.12, "depth": 0.04}
"""Offset of a Gaussian whose mean gradient is the attribute's root mean square."""
MEAN, SQUARE = 0.9, 0.99
"""Decay of the running means of a gradient and of its square."""
FURTHEST = 20.0
"""Bound of a step, in rates."""
COVERAGE = 0.05
"""Weight of the difference in coverage beside that in colour."""
LESSONS = 2
"""Pictures rendered and compared for one step."""
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
class Outcome:
    """How the optimisation of one frame went."""

    usable: int
    """Source views with a picture, a mask and Gaussians."""
    judge: int = -1
    """View that judged; -1: none, and nothing was done."""
    before: float = 0.0
    """Mean squared error of the judge's picture as the Gaussians came, sRGB 0..1."""
    after: float = 0.0
    """The same of what was kept."""
    step: int = 0
    """The step that was kept; 0 is the start."""
    warm: bool = False
    """Whether it started from what the frame before learnt."""
    masked: int = 0
    """Gradients that were not finite and were set to 0."""

    def row(self) -> list[float]:
        """As `refinement/outcome` holds it."""
        return [self.usable, self.judge, self.before, self.after, self.step, self.warm, self.masked]


class _Steps:
    """Adam whose second moment is one number an attribute and view: a step is in proportion to the gradient.

    With a moment for each Gaussian of its own, one that hardly matters would move as far as one that makes the error, by
    the noise of single pictures: measured, half the gain and, of the depths, a loss.
    """

    def __init__(self) -> None:
        self.mean: Offsets = {}
        self.square: dict[str, float] = {}
        self.count = 0
        self.masked = 0

    def take(self, gaussians: ViewGaussians) -> None:
        """One step along the gradients, which are used up."""
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
            mean = self.mean.setdefault(name, np.zeros_like(g))
            mean *= np.float32(MEAN)
            mean += np.float32(1 - MEAN) * g
            self.square[name] = SQUARE * self.square.get(name, 0.0) + (1 - SQUARE) * float(np.mean(np.square(g, dtype=np.float64))) if g.size else 0.0
            size = np.sqrt(self.square[name] / (1 - SQUARE**self.count))
            if size > 0 and np.isfinite(size):
                values -= np.float32(RATES[name]) * np.clip(mean / np.float32(size * (1 - MEAN**self.count)), -FURTHEST, FURTHEST)
        gaussians.confine()


def draw(gaussians: Mapping[int, ViewGaussians], lesson: Lesson, camera: Camera) -> Rendering:
    """The picture of a lesson: the Gaussians of its views, weighted as rendering weights them."""
    parts = []
    for view, weight in lesson.parts:
        seen = gaussians[view].lifted().seen_from(camera)
        parts.append(replace(seen, opacity=seen.opacity * weight))
    return rasterize(Gaussians.concatenate(parts), [camera])


def loss(rendered: Rendering, filmed: Filmed) -> torch.Tensor:
    """Sum of w (mean_rgb |color - picture| + COVERAGE |alpha - mask|) over the pixels, all premultiplied.

    w is 1 beside the person, where all should be empty, and the rendered alpha, as a constant, on the person: what a view's
    neighbours do not see is a hole in their picture of it, and Gaussians around it that grow to fill it are wrong in every other.
    """
    alpha = rendered.alpha[0]
    difference = (rendered.color[0] - filmed.color).abs()
    error = (difference[..., 0] + difference[..., 1] + difference[..., 2]) / 3 + COVERAGE * (alpha - filmed.cover).abs()
    return (error * torch.where(filmed.cover > 0, alpha.detach(), 1.0)).sum()


def judged(gaussians: Mapping[int, ViewGaussians], lesson: Lesson, filmed: Filmed) -> float:
    """Mean squared error of a lesson's picture; summed by numpy, whose order does not depend on threads."""
    with torch.no_grad():
        color = draw(gaussians, lesson, filmed.camera).color[0].numpy()
    return float(np.mean(np.square(color - filmed.color.numpy(), dtype=np.float64)))


def optimise(gaussians: Mapping[int, ViewGaussians], filmed: Mapping[int, Filmed], plan: Schedule, steps: int, before: Mapping[int, Learnt]) -> Outcome:
    """Change the offsets of a frame's Gaussians, by view, to those of the best judged step; the start is step 0.

    Every course of the plan is followed from the same start, and the best of them all is kept. The start is what the frame
    `before` learnt where the judge finds that better. Deterministic: equal arguments give equal bits on any number of threads.
    """
    judge = filmed[plan.judge.target]
    first = best = judged(gaussians, plan.judge, judge)
    warm = False
    if before:
        for view, learnt in before.items():
            if view in gaussians:
                gaussians[view].start_from(learnt)
        found = judged(gaussians, plan.judge, judge)
        warm = found < best
        if warm:
            best = found
        else:
            for g in gaussians.values():
                g.put({name: np.zeros_like(a) for name, a in g.arrays().items()})
    start = {v: g.keep() for v, g in gaussians.items()}
    kept, at, masked = start, 0, 0
    for course in plan.courses:
        for view, g in gaussians.items():
            g.put(start[view])
        found = _follow(gaussians, filmed, plan.judge, course, steps, best)
        masked += found.masked
        if found.kept is not None:
            best, at, kept = found.error, found.step, found.kept
    for view, g in gaussians.items():
        g.put(kept[view])
    return Outcome(len(gaussians), plan.judge.target, first, best, at, warm, masked)


class _Found(NamedTuple):
    """What following a course led to."""

    kept: dict[int, Offsets] | None
    """Offsets by view of its best step; None where none was better than asked for."""
    error: float
    step: int
    masked: int


def _follow(gaussians: Mapping[int, ViewGaussians], filmed: Mapping[int, Filmed], judge: Lesson, course: Sequence[Lesson], steps: int, bound: float) -> _Found:
    """Take the steps of a course; its best judged one, if its error is below the bound."""
    best, at, kept = bound, 0, None
    walks = {v: _Steps() for v in gaussians}
    for step in range(1, steps + 1):
        lessons = [course[((step - 1) * LESSONS + k) % len(course)] for k in range(LESSONS)]
        for lesson in lessons:
            loss(draw(gaussians, lesson, filmed[lesson.target].camera), filmed[lesson.target]).backward()
        for view in sorted({v for lesson in lessons for v, _ in lesson.parts}):
            walks[view].take(gaussians[view])
        if step % JUDGED_EVERY == 0 or step == steps:
            found = judged(gaussians, judge, filmed[judge.target])
            if found < best:
                best, at, kept = found, step, {v: g.keep() for v, g in gaussians.items()}
            elif step - at >= PATIENCE * JUDGED_EVERY:
                break
    return _Found(kept, best, at, sum(w.masked for w in walks.values()))
