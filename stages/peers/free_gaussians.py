"""Per-scene 3D Gaussian splatting as published (Kerbl et al., 2023), through our own rasterizer: some thousand points
on the visual hull, free to move, cloned and split where the screen's gradient stays, pruned where they are transparent.

Rates, thresholds, opacities, loss and low pass are the paper's and its code's. Three things are not: colours do not
depend on the angle of view, the pictures are on black, as everywhere here, and the schedule is one of what may be spent
instead of 30000 steps: the rate of the means falls until all is spent, and Gaussians are added during the first half.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch

from posegaussian.stages.refinement.steps.loss import Filmed, weighed
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing, Gaussians, Rendering
from posegaussian.stages.splatting.quaternions import rotations
from posegaussian.stages.splatting.rasterizer import rasterize

POINTS = 4_000
"""On the hull's surface, of all views together."""
RATES = {"mean": 1.6e-4, "rotation": 1e-3, "scale": 5e-3, "opacity": 5e-2, "color": 2.5e-3}
"""Of Adam; that of the means times the extent of the cameras."""
FINAL = 0.01
"""What is left of the means' rate when all is spent."""
OPACITY = 0.1
"""At the start."""
DRAWING = Drawing(Cutoffs(low_pass=0.3))
GROWS_FROM, GROWS_EVERY, GROWS_UNTIL = 500, 100, 0.5
"""Step of the first growth, steps between two, and the share of what may be spent after which there is none."""
STEEP = 2e-4
"""Mean gradient of the position in the picture, of which width and height are 2, above which a Gaussian grows."""
LARGE, HUGE = 0.01, 0.1
"""Times the extent: above the first a Gaussian is split, else cloned; above the second it is dropped."""
PARTS, SMALLER = 2, 1.6
"""Gaussians made of a split one, and how much smaller they are."""
FAINT = 0.005
"""Opacity below which a Gaussian is dropped."""
RESET_EVERY, RESET_TO = 3000, 0.01
"""Steps between two resets of the opacities, while Gaussians are added, and their most after it."""


class FreeGaussians:
    """Means, quaternions, log scales, opacity logits and colours, with Adam's state."""

    def __init__(self, means: np.ndarray, colors: np.ndarray, extent: float) -> None:
        """Take means [N, 3] m, colors [N, 3] sRGB; as wide as the three nearest points are away. extent m."""
        points = torch.as_tensor(means, dtype=torch.float64)
        near = torch.cdist(points, points).topk(4, largest=False).values[:, 1:].numpy()
        width = np.sqrt((near**2).mean(axis=1))
        n = len(means)
        given = {
            "mean": means,
            "rotation": np.tile([1.0, 0, 0, 0], (n, 1)),
            "scale": np.log(np.repeat(np.maximum(width, 1e-7)[:, None], 3, axis=1)),
            "opacity": np.full(n, _logit(OPACITY)),
            "color": colors,
        }
        self.extent = extent
        self.values = {name: torch.tensor(v, dtype=torch.float32, requires_grad=True) for name, v in given.items()}
        rates = {name: rate * (extent if name == "mean" else 1.0) for name, rate in RATES.items()}
        self.adam = torch.optim.Adam(
            [{"params": [v], "lr": rates[k], "name": k} for k, v in self.values.items()], eps=1e-15
        )
        self.steepness, self.seen = torch.zeros(n), torch.zeros(n)

    def __len__(self) -> int:
        return len(self.values["mean"])

    def draw(self, camera: Camera) -> Rendering:
        """Its picture."""
        v = self.values
        opacity, scale = torch.sigmoid(v["opacity"]), torch.exp(v["scale"])
        return rasterize(
            Gaussians(v["mean"], rotations(v["rotation"]), scale, opacity, v["color"]), [camera], drawing=DRAWING
        )

    def step(self, picture: Filmed, mean_rate: float) -> None:
        """One step on one picture."""
        drawn = self.draw(picture.camera)
        color, alpha = (t[0].detach().numpy() for t in (drawn.color, drawn.alpha))
        slope = weighed(color, alpha, picture, np.ones_like(alpha), coverage=0.0).by_color
        drawn.color.backward(torch.from_numpy(slope / alpha.size)[None])
        self._note(picture.camera)
        self.adam.param_groups[0]["lr"] = mean_rate * self.extent
        self.adam.step()
        self.adam.zero_grad()

    def _note(self, camera: Camera) -> None:
        """Add up how steep the picture is in each position."""
        gradient = self.values["mean"].grad
        assert gradient is not None
        pose, k = (
            torch.as_tensor(np.asarray(m), dtype=torch.float32) for m in (camera.world_to_camera, camera.intrinsics)
        )
        with torch.no_grad():
            z = self.values["mean"] @ pose[2, :3] + pose[2, 3]
            across, down = (gradient @ pose[i, :3] * z / k[i, i] for i in (0, 1))
            self.steepness += torch.hypot(across * camera.width / 2, down * camera.height / 2)
            self.seen += gradient.abs().sum(dim=1) > 0

    def grow(self, generator: torch.Generator) -> None:
        """Clone small and split large Gaussians where the gradient stays, and drop the transparent and the huge."""
        with torch.no_grad():
            v = {name: t.detach() for name, t in self.values.items()}
            size = torch.exp(v["scale"]).amax(dim=1)
            steep = self.steepness / self.seen.clamp(min=1) >= STEEP
            clone, split = steep & (size <= LARGE * self.extent), steep & (size > LARGE * self.extent)
            parts = {name: t[split].repeat(PARTS, *[1] * (t.dim() - 1)) for name, t in v.items()}
            offset = torch.randn(parts["mean"].shape, generator=generator) * torch.exp(parts["scale"])
            parts["mean"] = parts["mean"] + (rotations(parts["rotation"]) @ offset[:, :, None])[:, :, 0]
            parts["scale"] = parts["scale"] - float(np.log(SMALLER))
            new = {name: torch.cat([t[clone], parts[name]]) for name, t in v.items()}
            self._replace(~split & (torch.sigmoid(v["opacity"]) >= FAINT) & (size <= HUGE * self.extent), new)

    def reset(self) -> None:
        """Opacities down to `RESET_TO`: what is not needed stays there."""
        with torch.no_grad():
            self.values["opacity"].clamp_(max=_logit(RESET_TO))
        state = self.adam.state[self.values["opacity"]]
        for name in ("exp_avg", "exp_avg_sq"):
            state[name].zero_()

    def _replace(self, keep: torch.Tensor, new: dict[str, torch.Tensor]) -> None:
        """Those to keep [N] bool, then new ones, whose state in Adam is 0."""
        for group in self.adam.param_groups:
            name = group["name"]
            old = self.values[name]
            state = self.adam.state.pop(old)
            for key in ("exp_avg", "exp_avg_sq"):
                state[key] = torch.cat([state[key][keep], torch.zeros_like(new[name])])
            self.values[name] = torch.cat([old.detach()[keep], new[name]]).requires_grad_(True)
            group["params"] = [self.values[name]]
            self.adam.state[self.values[name]] = state
        self.steepness, self.seen = torch.zeros(len(self)), torch.zeros(len(self))


def _logit(p: float) -> float:
    return float(np.log(p / (1 - p)))


def optimise(gaussians: FreeGaussians, filmed: Sequence[Filmed], spent: Callable[[int], float]) -> Iterator[int]:
    """Optimise on all pictures in random order, while `spent`, which is told how many steps were made, says a share
    below 1 of what may be spent. Yields the number of steps after each."""
    order, generator, step = np.random.default_rng(0), torch.Generator().manual_seed(0), 0
    while (share := spent(step)) < 1:
        picture = filmed[int(order.integers(len(filmed)))]
        gaussians.step(picture, RATES["mean"] * FINAL**share)
        step += 1
        if share < GROWS_UNTIL:
            if step >= GROWS_FROM and step % GROWS_EVERY == 0:
                gaussians.grow(generator)
            if step % RESET_EVERY == 0:
                gaussians.reset()
        yield step


def start(points: np.ndarray, colors: np.ndarray, centres: np.ndarray, count: int = POINTS) -> FreeGaussians:
    """As many of the points [N, 3] m, colors [N, 3] sRGB 0..1, at random; the extent is that of the source cameras'
    centres [V, 3] m, as 3DGS has it."""
    chosen = np.random.default_rng(0).permutation(len(points))[:count]
    extent = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max() * 1.1)
    return FreeGaussians(points[chosen], colors[chosen], extent)
