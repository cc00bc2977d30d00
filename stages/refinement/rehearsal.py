"""Gaussians optimised on a frame's source pictures: a rehearsal without the judge's view says for how many steps, then
all views are trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from posegaussian.stages.refinement.judging import Judge, Judgement
from posegaussian.stages.refinement.schedule import Schedule
from posegaussian.stages.refinement.steps.attributes import ViewGaussians
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.refinement.steps.optimise import HostWalk, Walk
from posegaussian.stages.splatting.device import device
from posegaussian.stages.splatting.gpu.backend import lacks

JUDGED_EVERY = 10
"""Steps from one judgement to the next."""
PATIENCE = 5
"""Judgements without one as good after which a frame is done, where any gain is worth it."""
ALIKE = 10**0.005
"""Times the least error, up to which a later judgement is as good where any gain is worth it: 0.05 dB, about twice of
what one differs from the next by chance. Where errors hardly fall any more, which of them is least is chance, too, and
with it was whether 50 or 200 steps were made. All views are trained on then, and they go on gaining where the judge's
picture has stopped: three of eleven tuning people (384 px) make more steps than with 0.02 dB, and have 0.02, 0.06 and
0.08 dB more."""
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
    """The step that is kept; 0 is the start."""
    share: float
    """Of the refined Gaussians' picture in the mixture that the judge found best, 0..1."""
    masked: int
    """Gradients that were not finite and were set to 0."""

    @property
    def refines(self) -> bool:
        """Whether any step made a better picture."""
        return self.after < self.before

    @property
    def clear(self) -> bool:
        """Whether it is better by more than chance."""
        return self.after * ALIKE < self.before

    def gains_more(self, other: Rehearsal) -> bool:
        """Whether its picture got better by a larger factor than another one's."""
        return self.after * other.before < other.after * self.before


def begin(gaussians: Mapping[int, ViewGaussians], filmed: Mapping[int, Filmed], order: Sequence[int]) -> Walk:
    """A walk on this worker's device; on the CPU where the device has no Triton to walk with."""
    where = device()
    if where.type == "cpu" or lacks(where):
        return HostWalk(gaussians, filmed, order)
    from posegaussian.stages.refinement.steps.on_device import DeviceWalk  # imports Triton

    return DeviceWalk(gaussians, filmed, order, where)


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
    judgements gained less than `worth` dB on their mean. Where any gain is worth it, the last step that is as good as
    the best.

    Deterministic: equal arguments give equal bits on any number of threads, and on a device in every run.
    """
    walk = begin({v: g for v, g in gaussians.items() if v != plan.judge}, filmed, plan.pupils)
    best, at, errors = Judgement(judge.before, 0.0), 0, list[float]()
    for step in range(1, steps + 1):
        walk.step()
        if step % JUDGED_EVERY == 0 or step == steps:
            found = judge.judgement(walk.reached.gaussians)
            errors.append(min([found.error, *errors[-1:]]))
            as_good = worth == 0 and found.error <= ALIKE * errors[-1]
            if found.error < (judge.before if as_good else best.error):
                best, at = found, step
            if step - at >= PATIENCE * JUDGED_EVERY or not _worth_more(errors, worth):
                break
    return Rehearsal(plan.judge, judge.before, best.error, at, best.share, walk.masked)


def _worth_more(errors: Sequence[float], worth: float) -> bool:
    """Whether the least error so far, at each judgement, fell by `worth` dB a judgement on the mean of the last
    `WINDOW`."""
    return len(errors) <= WINDOW or errors[-1] <= errors[-1 - WINDOW] * 10 ** (-0.1 * WINDOW * worth)
