"""Steps of Gaussians on a frame's source pictures: what they are of, how far one moves what is optimised, and what of
many is kept. `HostWalk` takes them on the CPU, `posegaussian.stages.refinement.steps.on_device` on a GPU."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
import torch

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.refinement.steps.attributes import Offsets, SharedGaussians, ViewGaussians
from posegaussian.stages.refinement.steps.loss import Filmed, loss
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians
from posegaussian.stages.splatting.rasterizer import rasterize

RATES = {"color": 0.0025, "scale": 0.08, "rotation": 0.0015, "opacity": 0.1, "depth": 0.2, "twist": 0.1, "shift": 0.03}
"""Of Adam, in the units of the offsets, with `USUAL_PICTURES` source pictures. Twice the colour's overfit by 100 steps.
The normal's: a disc that leans serves the source pictures with its rim, which stands out from a limb to all other
cameras. At 0.01 twelve tuning people have 0.11 dB less on the mean (-0.04 to 0.30); where normals stay, one of sixteen
cameras has 0.56 less. The turn's: an arc of four cameras that leans by 45 degrees, checked cloth (seed 2, 320 px,
`benchmarks.quality.held`), 28.63 dB without, 29.85 at 0.02 and half the bound, 30.14 at 0.1; eight cameras around seed
1 (384 px) 31.23, 31.37 at 0.1 and, with twice the rate and twice the bound, 31.23.

Size, depth and shift, seventeen tuning people of 4 to 16 cameras (384 px), refined Gaussians alone after 20, 50 and 100
steps: with 0.03, 0.4 and no shift 0.52, 0.32 and 0.26 dB less on the mean, without the shift alone 0.13, 0.14 and 0.17.
Of one of sixteen cameras a shift of 0.05 and 0.12 lost 0.4 and 1.3 dB (50 steps, before sizes went faster)."""
USUAL_PICTURES, FEW_PICTURES = 8, 4
"""Of so many, rates are as they stand; of others they are more or less by the root of the ratio, and of few as of those
few: each picture moves the Gaussians its own way, and the more there are, the less one of them should. Sixteen pictures
(tuning people 1 and 8, 384 px) have 33.0 and 30.6 dB after 60 steps, 32.8 and 30.3 at the rates of eight; four (3 and
4) end with 0.11 and 0.19 dB more than at those, three (`balance` and `desk`) with 0.09 and 0.05 less."""
USUAL_EXTENT, FINEST = 440, 4
"""Px of the longer side of what a mask holds up to which rates stand, a person in a picture of 512 px; and up to how
many times as large a one they grow."""
FINER = ("depth", "shift")
"""Attributes whose rates grow so: their units are pixels, and what is wrong by a centimetre is wrong by as many more of
them."""
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


def rates_of(pictures: int, usual: Mapping[str, float]) -> dict[str, float]:
    """{attribute: rate} where so many pictures move the Gaussians, of the rates with `USUAL_PICTURES`."""
    less = (USUAL_PICTURES / max(pictures, FEW_PICTURES)) ** 0.5
    return {name: rate * less for name, rate in usual.items()}


def fitting_rates(pictures: Sequence[Filmed]) -> dict[str, float]:
    """`RATES` for subjects as large as these pictures show them, by the middle one."""
    finer = float(np.clip(np.median([_extent(p.cover) for p in pictures]) / USUAL_EXTENT, 1, FINEST))
    return {name: rate * (finer if name in FINER else 1.0) for name, rate in RATES.items()}


def _extent(cover: np.ndarray) -> int:
    """Px of the longer side of the box around what a mask [h, w] holds."""
    sides = [np.flatnonzero(cover.any(axis=axis)) for axis in (0, 1)]
    return max(int(s[-1] - s[0]) + 1 if len(s) else 0 for s in sides)


class Walk(ABC):
    """Steps of the Gaussians of some views on the pictures of `order`, one after the other, again and again."""

    def __init__(
        self, gaussians: Mapping[int, ViewGaussians], filmed: Mapping[int, Filmed], order: Sequence[int]
    ) -> None:
        self.gaussians, self.pictures = SharedGaussians(gaussians), [filmed[v] for v in order]
        self.a_step = max(2, round(PICTURES * len(self.pictures)))
        self.made = 0

    def step(self) -> None:
        """Of the next pictures, each of which moves the Gaussians."""
        slower = 1 + self.made / SLOWER
        for k in range(self.a_step):
            self._learn((self.made * self.a_step + k) % len(self.pictures), slower)
        self.made += 1
        self._remember()

    @property
    @abstractmethod
    def masked(self) -> int:
        """Gradients that were not finite and were set to 0."""

    @property
    @abstractmethod
    def reached(self) -> SharedGaussians:
        """Where the last steps were on the mean, on the CPU."""

    @abstractmethod
    def _learn(self, picture: int, slower: float) -> None:
        """Move the Gaussians by one of the pictures, at rates divided by `slower`."""

    @abstractmethod
    def _remember(self) -> None:
        """Take where the Gaussians are now into the mean over steps, as `NEWEST` of it."""


class HostWalk(Walk):
    """On the CPU; equal arguments give equal bits on any number of threads."""

    def __init__(
        self,
        gaussians: Mapping[int, ViewGaussians],
        filmed: Mapping[int, Filmed],
        order: Sequence[int],
        rates: Mapping[str, float] | None = None,
    ) -> None:
        """`rates` with `USUAL_PICTURES`; None: those that fit the pictures."""
        super().__init__(gaussians, filmed, order)
        self.adam = _Adam(self.gaussians, rates_of(len(self.pictures), rates or fitting_rates(self.pictures)))
        self.average: Offsets = {name: a.copy() for name, a in self.gaussians.offsets.items()}

    @property
    def masked(self) -> int:
        """Counted by Adam."""
        return self.adam.masked

    @property
    def reached(self) -> SharedGaussians:
        """Of the same Gaussians."""
        return self.gaussians.with_offsets(self.average)

    def _learn(self, picture: int, slower: float) -> None:
        gaussians = self._with_slopes(picture, self.pictures[picture].camera)
        self.adam.step(self.gaussians.slopes(gaussians), slower)

    def _with_slopes(self, picture: int, camera: Camera) -> Gaussians:
        """The Gaussians as they are, with their gradients in a picture that a camera takes."""
        filmed, gaussians = self.pictures[picture], self.gaussians.gaussians()
        drawn = rasterize(gaussians, [camera])
        _, by_color, by_alpha = loss(drawn.color[0].detach().numpy(), drawn.alpha[0].detach().numpy(), filmed)
        slopes = torch.from_numpy(by_color)[None], torch.from_numpy(by_alpha)[None]
        torch.autograd.backward(
            [drawn.color, drawn.alpha, gaussians.opacity], [*slopes, torch.full_like(gaussians.opacity, NEEDLESS)]
        )
        return gaussians

    def _remember(self) -> None:
        for name, a in self.gaussians.offsets.items():
            self.average[name] += np.float32(NEWEST) * (a - self.average[name])


class _Adam:
    """Adam for the offsets, element by element: torch's own may round by the place in the array, which threads share
    out."""

    def __init__(self, gaussians: SharedGaussians, rates: Mapping[str, float]) -> None:
        """{attribute: rate}."""
        self.gaussians, self.rates = gaussians, rates
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
            self.masked += move(values, slopes[name], self.mean[name], self.square[name], rate, unbiased)
        self.gaussians.confine()


@compiled(error_model="numpy")
def move(values, slopes, mean, square, rate, unbiased):  # type: ignore[no-untyped-def]
    """Move values [C, N] by Adam, and the running means of their slopes and of these squared, all float32 and in place;
    returns how many slopes are not finite, which count as 0."""
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
