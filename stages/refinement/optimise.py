"""Gaussians optimised on a frame's source pictures: a rehearsal without the judge's view says for how many steps, then
all views are trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numba import njit

from posegaussian.stages.refinement.attributes import Offsets, SharedGaussians, ViewGaussians
from posegaussian.stages.refinement.judging import Judge, Judgement, draw
from posegaussian.stages.refinement.loss import Filmed, loss
from posegaussian.stages.refinement.schedule import Schedule

RATES = {"color": 0.0025, "scale": 0.03, "rotation": 0.0015, "opacity": 0.1, "depth": 0.4, "twist": 0.1}
"""Of Adam, in the units of the offsets, with `USUAL_PICTURES` source pictures. About half of them gained a fifth less
in 50 steps (seeds 2 and 3); twice the colour's overfit by 100. The size's: 0.03 in place of 0.02 gains 0.03 dB on the
mean of eight tuning people (384 px). The normal's: a disc that leans serves the source pictures with its rim, which
stands out from a limb to all other cameras. At 0.01 twelve tuning people have 0.11 dB less on the mean (-0.04 to 0.30);
where normals stay, one of sixteen cameras has 0.56 less. The turn's: an arc of four cameras that leans by 45 degrees,
checked cloth (seed 2, 320 px, `benchmarks.quality.held`), 28.63 dB without, 29.85 at 0.02 and half the bound, 30.14 at
0.1; eight cameras around seed 1 (384 px) 31.23, 31.37 at 0.1 and, with twice the rate and twice the bound, 31.23."""
USUAL_PICTURES, FEW_PICTURES = 8, 4
"""Of so many, rates are as they stand; of others they are more or less by the root of the ratio, and of few as of those
few: each picture moves the Gaussians its own way, and the more there are, the less one of them should. Sixteen pictures
(tuning people 1 and 8, 384 px) have 33.0 and 30.6 dB after 60 steps, 32.8 and 30.3 at the rates of eight; four (3 and
4) end with 0.11 and 0.19 dB more than at those, three (`balance` and `desk`) with 0.09 and 0.05 less."""
MEAN, SQUARE = 0.9, 0.999
"""Decay of the running means of a gradient and of its square."""
SLOWER = 100
"""Steps after which the rates are half of what they were: they fall as 1 / (1 + step / SLOWER), whatever number of
steps is asked for, so that fewer steps are the beginning of more. With 25 box PSNR was 0.07 to 0.22 dB lower after 50
steps on four simulated people filmed by four to eight cameras; with 400 it is the same."""
NEEDLESS = 0.05
"""Cost of a Gaussian's opacity, in pixels' differences: what no picture calls for fades, such as points of bad depth
that lie where no view sees them. 26.50 -> 26.84 dB after 52 steps (seed 2); four times as much: 26.54."""
PICTURES = 1 / 4
"""Of the source pictures, two at least, are a step; each moves the Gaussians. With two of sixteen 50 steps look at each
only six times: 0.62 and 0.03 dB lower on the two reporting people filmed by sixteen cameras."""
NEWEST = 0.2
"""Share of the newest step in the mean over steps, which is what is judged and kept: about one pass over all pictures.
The last picture leaves its mark on the Gaussians, so where steps end was worth 0.3 dB by chance with sixteen pictures.
Their mean has 0.2 to 0.5 dB more than the last step there, 0.1 with six or eight, 0.0 with four; over twice or four
times as many steps it lags in the first 60."""
JUDGED_EVERY = 10
"""Steps from one judgement to the next."""
PATIENCE = 5
"""Judgements without a better one after which a frame is done, where any gain is worth it."""
WINDOW = 3
"""Judgements over which steps must have been worth it: of sixteen pictures, four a step, one judgement may be 0.3 dB
worse than the one before and the next one better again."""


@dataclass(frozen=True)
class Rehearsal:
    """What was found without the judge's view."""

    judge: int
    """View that judged."""
    before: float
    """Mean squared error of the judge's picture without refinement, sRGB 0..1."""
    after: float
    """The same of the mixture; less than `before` where refinement is a gain."""
    step: int
    """The best step; 0 is the start."""
    share: float
    """Of the refined Gaussians' picture in the mixture that the judge found best, 0..1."""
    masked: int
    """Gradients that were not finite and were set to 0."""

    @property
    def refines(self) -> bool:
        """Whether any step made a better picture."""
        return self.after < self.before


class _Adam:
    """Adam for the offsets, element by element: torch's own may round by the place in the array, which threads share
    out."""

    def __init__(self, gaussians: SharedGaussians, pictures: int) -> None:
        """Of Gaussians that so many pictures move."""
        self.gaussians = gaussians
        ratio = USUAL_PICTURES / max(pictures, FEW_PICTURES)
        self.rates = {name: rate * ratio**0.5 for name, rate in RATES.items()}
        self.mean: Offsets = {name: np.zeros_like(a) for name, a in gaussians.offsets.items()}
        self.square: Offsets = {name: np.zeros_like(a) for name, a in gaussians.offsets.items()}
        self.count = 0
        self.masked = 0

    def step(self, slopes: Offsets, slower: float) -> None:
        """One step against slopes by the offsets, at rates divided by `slower`; one that is not finite counts as 0."""
        self.count += 1
        for name, values in self.gaussians.offsets.items():
            rate = np.float32(self.rates[name] / slower / (1 - MEAN**self.count))
            unbiased = np.float32(1 / (1 - SQUARE**self.count))
            self.masked += _move(values, slopes[name], self.mean[name], self.square[name], rate, unbiased)
        self.gaussians.confine()


@njit(cache=True, nogil=True, error_model="numpy")
def _move(values, slopes, mean, square, rate, unbiased):  # type: ignore[no-untyped-def]
    """Move values [C, N], and the running means of their slopes and of these squared, all in place; returns how many
    slopes are not finite."""
    masked, nearer, larger = 0, np.float32(1 - MEAN), np.float32(1 - SQUARE)
    for c in range(values.shape[0]):
        for n in range(values.shape[1]):
            g = slopes[c, n]
            if not np.isfinite(g):
                masked += 1
                g = np.float32(0)
            mean[c, n] += nearer * (g - mean[c, n])
            square[c, n] += larger * (g * g - square[c, n])
            size = np.sqrt(square[c, n] * unbiased)
            if size > 0 and np.isfinite(size):
                values[c, n] -= rate * mean[c, n] / size
    return masked


def rehearse(
    gaussians: Mapping[int, ViewGaussians],
    filmed: Mapping[int, Filmed],
    plan: Schedule,
    steps: int,
    worth: float,
    judge: Judge,
) -> Rehearsal:
    """At which of at most `steps` steps the judge's picture is best, drawn from the other views' Gaussians, trained on
    the other views' pictures, and mixed with the one without refinement; no more are tried once the last `WINDOW`
    judgements gained less than `worth` dB on their mean.

    Deterministic: equal arguments give equal bits on any number of threads.
    """
    walk = Walk({v: g for v, g in gaussians.items() if v != plan.judge}, filmed, plan.pupils)
    best, at, errors = Judgement(judge.before, 0.0), 0, list[float]()
    for step in range(1, steps + 1):
        walk.step()
        if step % JUDGED_EVERY == 0 or step == steps:
            found = judge.judgement(walk.reached.gaussians)
            if found.error < best.error:
                best, at = found, step
            errors.append(min([found.error, *errors[-1:]]))
            if step - at >= PATIENCE * JUDGED_EVERY or not _worth_more(errors, worth):
                break
    return Rehearsal(plan.judge, judge.before, best.error, at, best.share, walk.masked)


def _worth_more(errors: Sequence[float], worth: float) -> bool:
    """Whether the least error so far, at each judgement, fell by `worth` dB a judgement on the mean of the last
    `WINDOW`."""
    return len(errors) <= WINDOW or errors[-1] <= errors[-1 - WINDOW] * 10 ** (-0.1 * WINDOW * worth)


class Walk:
    """Steps of the Gaussians of some views on the pictures of `order`, one after the other, again and again."""

    def __init__(
        self, gaussians: Mapping[int, ViewGaussians], filmed: Mapping[int, Filmed], order: Sequence[int]
    ) -> None:
        self.gaussians, self.pictures = SharedGaussians(gaussians), [filmed[v] for v in order]
        self.a_step = max(2, round(PICTURES * len(self.pictures)))
        self.adam = _Adam(self.gaussians, len(self.pictures))
        self.average: Offsets = {name: a.copy() for name, a in self.gaussians.offsets.items()}
        self.made = 0

    @property
    def masked(self) -> int:
        """Gradients that were not finite and were set to 0."""
        return self.adam.masked

    @property
    def reached(self) -> SharedGaussians:
        """Where the last steps were on the mean."""
        return self.gaussians.with_offsets(self.average)

    def step(self) -> None:
        """Of the next pictures, each of which moves the Gaussians."""
        for k in range(self.a_step):
            picture = self.pictures[(self.made * self.a_step + k) % len(self.pictures)]
            gaussians = self.gaussians.gaussians()
            drawn = draw(gaussians, picture.camera)
            _, by_color, by_alpha = loss(drawn.color[0].detach().numpy(), drawn.alpha[0].detach().numpy(), picture)
            slopes = torch.from_numpy(by_color)[None], torch.from_numpy(by_alpha)[None]
            torch.autograd.backward(
                [drawn.color, drawn.alpha, gaussians.opacity], [*slopes, torch.full_like(gaussians.opacity, NEEDLESS)]
            )
            self.adam.step(self.gaussians.slopes(gaussians), 1 + self.made / SLOWER)
        self.made += 1
        for name, a in self.gaussians.offsets.items():
            self.average[name] += np.float32(NEWEST) * (a - self.average[name])
