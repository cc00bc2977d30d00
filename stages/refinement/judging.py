"""What the judge finds: a mixture of two pictures, drawn from refined Gaussians and drawn without refinement.

The refined Gaussians are one body for all views: smooth, whole and steady, of one colour from all sides. Without
refinement a picture is drawn from the two nearest views alone: sharp, in their light, with the holes and the noise of
their depth. They err at different places and in different ways, so their mean errs less than either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from posegaussian.stages.refinement.schedule import Schedule
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.rendering.lift import Lifted
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians, Rendering
from posegaussian.stages.splatting.device import device
from posegaussian.stages.splatting.rasterizer import rasterize

USUAL = 0.65
"""The usual share. After 100 steps about 0.6 to 0.9 fit best midway between cameras on six simulated scenes of 4 to 16
cameras, of which the judge said 0.42 to 0.84; on `bust` 0.45, where it said 0.36. One half in its place costs the
simulated ones up to 0.17 dB and gives the photographs that `bust` keeps aside 0.02."""
AT_MOST = 1.5
"""Times the judge's best share; the error grows with the square of the distance from it."""


class Judgement(NamedTuple):
    """Of refined Gaussians."""

    error: float
    """Mean squared error of the mixture, sRGB 0..1."""
    share: float
    """Of the refined Gaussians' picture in the mixture, 0..1."""


@dataclass(frozen=True, eq=False)
class Judge:
    """The view that is left out of the rehearsal."""

    filmed: Filmed
    unrefined: np.ndarray
    """[h, w, 3] its picture without refinement, from its neighbours."""

    @classmethod
    def of(cls, filmed: Filmed, lifted: Mapping[int, Lifted], plan: Schedule) -> Judge:
        """With the picture of the neighbours' Gaussians, weighted as rendering weights them."""
        parts = []
        for view, weight in plan.neighbours:
            seen = lifted[view].seen_from(filmed.camera)
            parts.append(replace(seen, opacity=seen.opacity * weight))
        return cls(filmed, draw(Gaussians.concatenate(parts), filmed.camera).color[0].numpy())

    @property
    def before(self) -> float:
        """Mean squared error without refinement."""
        unrefined = self._compared(self.unrefined)
        return error_of(0.0, unrefined, unrefined, self._compared(self.filmed.color))

    def judgement(self, refined: Callable[[], Gaussians]) -> Judgement:
        """Of refined Gaussians, which are made without their gradients."""
        with torch.no_grad():
            picture = draw(refined(), self.filmed.camera).color[0].numpy()
        three = [self._compared(p) for p in (picture, self.unrefined, self.filmed.color)]
        share = settled(best_share(*three))
        return Judgement(error_of(share, *three), share)

    def _compared(self, picture: np.ndarray) -> np.ndarray:
        """Of a picture [h, w, 3] what is compared: all, but where the mask may lack something."""
        return picture if self.filmed.lacking is None else picture[~self.filmed.lacking]


def draw(gaussians: Gaussians, camera: Camera) -> Rendering:
    """The picture of Gaussians, all of them in it, drawn on the worker's device and brought back to theirs."""
    home = gaussians.mean.device
    drawn = rasterize(gaussians.to(device()), [camera])
    return drawn._replace(color=drawn.color.to(home), alpha=drawn.alpha.to(home))


def best_share(refined: np.ndarray, unrefined: np.ndarray, truth: np.ndarray) -> float:
    """The share s in 0..1 for which s refined + (1 - s) unrefined is nearest to the truth, [..., 3] each.

    Least squares: s = <refined - unrefined, truth - unrefined> / |refined - unrefined|^2, clipped; 0 where the pictures
    are equal. Summed by numpy, whose order does not depend on threads.
    """
    step, missing = (a.astype(np.float64) - unrefined for a in (refined, truth))
    length = float((step * step).sum())
    return min(max(float((step * missing).sum()) / length, 0.0), 1.0) if length > 0 else 0.0


def error_of(share: float, refined: np.ndarray, unrefined: np.ndarray, truth: np.ndarray) -> float:
    """Mean squared error of the mixture."""
    step, missing = (a.astype(np.float64) - unrefined for a in (refined, truth))
    return float(np.mean(np.square(share * step - missing)))


def settled(best: float) -> float:
    """The share that is taken where `best` fits the judge's picture: half way to the usual one, for one view tells
    little of the others; never where the judge would gain less than three quarters of what it could."""
    return min((best + USUAL) / 2, AT_MOST * best)
