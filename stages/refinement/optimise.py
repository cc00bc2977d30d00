"""One frame's Gaussians, optimised on its source pictures: a rehearsal without the judge's view says for how many
steps, then all views are trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from posegaussian.stages.refinement.attributes import Learnt, Offsets, ViewGaussians
from posegaussian.stages.refinement.judging import Filmed, Judge, Judgement, draw
from posegaussian.stages.refinement.schedule import Schedule
from posegaussian.stages.refinement.structure import dissimilarity
from posegaussian.stages.splatting.definition.scene import Rendering

RATES = {"color": 0.0025, "scale": 0.02, "rotation": 0.01, "opacity": 0.1, "depth": 0.4}
"""Of Adam, in the units of the offsets. About half of them gained a fifth less in 50 steps (seeds 2 and 3); twice
those of normal, scale and colour overfit by 100."""
MEAN, SQUARE = 0.9, 0.999
"""Decay of the running means of a gradient and of its square."""
SLOWER = 25
"""Steps after which the rates are half of what they were: they fall as 1 / (1 + step / SLOWER), whatever number of
steps is asked for, so that fewer steps are the beginning of more."""
COVERAGE = 0.05
"""Weight of the difference in coverage beside that in colour."""
STRUCTURE = 0.2
"""Share of D-SSIM in the difference of a pixel, as published (Kerbl et al., "3D Gaussian Splatting", 2023)."""
NEEDLESS = 0.05
"""Cost of a Gaussian's opacity, in pixels' differences: what no picture calls for fades, such as points of bad depth
that lie where no view sees them. 26.50 -> 26.84 dB after 52 steps (seed 2); four times as much: 26.54."""
PICTURES = 2
"""Source pictures of a step; each moves the Gaussians."""
JUDGED_EVERY = 10
"""Steps from one judgement to the next."""
PATIENCE = 5
"""Judgements without a better one after which a frame is done."""


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
    """The same in the rehearsal, of the mixture; less than `before` where the frame was refined."""
    step: int = 0
    """The best step of the rehearsal, and as many as were then made on all views; 0 is the start."""
    warm: bool = False
    """Whether it started from what the frame before learnt."""
    masked: int = 0
    """Gradients that were not finite and were set to 0."""
    share: float = 0.0
    """Of the refined Gaussians' picture in the mixture that the judge found best, 0..1."""

    @property
    def refined(self) -> bool:
        """Whether the frame is another than it was."""
        return self.after < self.before

    def row(self) -> list[float]:
        """As `refinement/outcome` holds it."""
        return [self.usable, self.judge, self.before, self.after, self.step, self.warm, self.masked, self.share]


class _Adam:
    """Adam for the offsets of one view, in numpy: torch's own may round by an element's place in the array, which
    threads share out."""

    def __init__(self) -> None:
        self.mean: Offsets = {}
        self.square: Offsets = {}
        self.count = 0
        self.masked = 0

    def step(self, gaussians: ViewGaussians, slower: float) -> None:
        """One step along the gradients, which are used up, at rates divided by `slower`; one that is not finite counts
        as 0."""
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
            values -= np.float32(RATES[name] / slower / (1 - MEAN**self.count)) * np.divide(
                mean, size, out=np.zeros_like(mean), where=ahead
            )
        gaussians.confine()


def loss(rendered: Rendering, filmed: Filmed) -> torch.Tensor:
    """Sum of w ((1 - STRUCTURE) mean_rgb |color - picture| + STRUCTURE D-SSIM + COVERAGE |alpha - mask|) over the
    pixels, all premultiplied.

    w is 1 beside the person, where all should be empty, and the rendered alpha, as a constant, on the person: what no
    depth map holds is a hole, and Gaussians around it that grow to fill it in one picture are wrong in every other.
    """
    alpha = rendered.alpha[0]
    weight = torch.where(filmed.cover > 0, alpha.detach(), 1.0)
    difference = (rendered.color[0] - filmed.color).abs()
    absolute = (difference[..., 0] + difference[..., 1] + difference[..., 2]) / 3
    error = (1 - STRUCTURE) * absolute + COVERAGE * (alpha - filmed.cover).abs()
    return (error * weight).sum() + STRUCTURE * dissimilarity(rendered.color[0], filmed.color, weight)


@dataclass(frozen=True)
class Memory:
    """What a frame learnt, by view, for the frame after it: nothing that the judge's picture taught gets into the next
    frame's rehearsal."""

    rehearsal: Mapping[int, Learnt] = field(default_factory=dict)
    """At the best step without the judge's view."""
    whole: Mapping[int, Learnt] = field(default_factory=dict)
    """On all views."""


def optimise(
    gaussians: Mapping[int, ViewGaussians],
    filmed: Mapping[int, Filmed],
    plan: Schedule,
    steps: int,
    before: Memory,
    judge: Judge,
) -> tuple[OptimisedFrame, Memory]:
    """Change the offsets of a frame's Gaussians, by view, where the judge finds that a gain; how it went, and what was
    learnt.

    In the rehearsal the judge's view takes no part: the others' Gaussians are trained on the others' pictures, and the
    judge's picture of them is mixed with the one without refinement. If at a step of at most `steps` a mixture is
    better than the latter, all start anew and make as many steps on all pictures. Both start from what the frame
    `before` learnt where the judge finds that better.
    Deterministic: equal arguments give equal bits on any number of threads.
    """
    others = {v: g for v, g in gaussians.items() if v != plan.judge}
    rehearsal = _rehearse(others, filmed, plan, steps, before.rehearsal, judge)
    learnt = {v: g.learnt() for v, g in others.items()}
    for g in gaussians.values():
        g.reset()
    if not rehearsal.refined:
        return rehearsal, Memory()
    if rehearsal.warm:
        _start(gaussians, before.whole)
    walk = Walk(gaussians, filmed, (*plan.pupils, plan.judge))
    for _ in range(rehearsal.step):
        walk.step()
    masked = rehearsal.masked + walk.masked
    return replace(rehearsal, usable=len(gaussians), masked=masked), Memory(
        learnt, {v: g.learnt() for v, g in gaussians.items()}
    )


def _rehearse(
    gaussians: Mapping[int, ViewGaussians],
    filmed: Mapping[int, Filmed],
    plan: Schedule,
    steps: int,
    before: Mapping[int, Learnt],
    judge: Judge,
) -> OptimisedFrame:
    """Optimise the pupils' Gaussians to the best judged step, and say which that is."""
    warm = _warm(gaussians, judge, before)
    error, at, kept = judge.before, 0, None
    best = Judgement(error, 0.0)
    if warm and (found := judge.judgement(gaussians)).error < best.error:
        best, kept = found, {v: g.keep() for v, g in gaussians.items()}
    walk = Walk(gaussians, filmed, plan.pupils)
    for step in range(1, steps + 1):
        walk.step()
        if step % JUDGED_EVERY == 0 or step == steps:
            found = judge.judgement(gaussians)
            if found.error < best.error:
                best, at, kept = found, step, {v: g.keep() for v, g in gaussians.items()}
            elif step - at >= PATIENCE * JUDGED_EVERY:
                break
    for view, offsets in (kept or {}).items():
        gaussians[view].put(offsets)
    return OptimisedFrame(len(gaussians) + 1, plan.judge, error, best.error, at, warm, walk.masked, best.share)


class Walk:
    """Steps of the Gaussians of some views on the pictures of `order`, one after the other, again and again."""

    def __init__(
        self, gaussians: Mapping[int, ViewGaussians], filmed: Mapping[int, Filmed], order: Sequence[int]
    ) -> None:
        self.gaussians, self.pictures = gaussians, [filmed[v] for v in order]
        self.walks = {v: _Adam() for v in gaussians}
        self.made = 0

    @property
    def masked(self) -> int:
        """Gradients that were not finite and were set to 0."""
        return sum(w.masked for w in self.walks.values())

    def step(self) -> None:
        """Of PICTURES pictures, each of which moves the Gaussians."""
        for k in range(PICTURES):
            picture = self.pictures[(self.made * PICTURES + k) % len(self.pictures)]
            parts = [g.gaussians() for g in self.gaussians.values()]
            error = loss(draw(parts, picture.camera), picture)
            torch.stack([error, *(NEEDLESS * p.opacity.sum() for p in parts)]).sum().backward()
            for view, g in self.gaussians.items():
                self.walks[view].step(g, 1 + self.made / SLOWER)
        self.made += 1


def _start(gaussians: Mapping[int, ViewGaussians], before: Mapping[int, Learnt]) -> None:
    for view, learnt in before.items():
        if view in gaussians:
            gaussians[view].start_from(learnt)


def _warm(gaussians: Mapping[int, ViewGaussians], judge: Judge, before: Mapping[int, Learnt]) -> bool:
    """Start from what another frame learnt; back again where the judge finds that no better."""
    if not before:
        return False
    cold = judge.judgement(gaussians)
    _start(gaussians, before)
    if judge.judgement(gaussians).error < cold.error:
        return True
    for g in gaussians.values():
        g.reset()
    return False
