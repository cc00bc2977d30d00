"""Per-scene optimisation as a user of 3DGS runs it: points on the visual hull, isotropic, free to move; no depth, no
normals, no pixels.

Rates, opacities and the low pass are those of 3DGS (Kerbl et al. 2023, without densification); the loss is that of the
refinement stage.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import torch

from posegaussian.stages.refinement.optimise import Filmed, loss
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing, Gaussians, Rendering
from posegaussian.stages.splatting.quaternions import rotations
from posegaussian.stages.splatting.rasterizer import rasterize

POINTS = 60_000
"""On the hull's surface, of all views together."""
RATES = {"mean": 1.6e-4, "rotation": 1e-3, "scale": 5e-3, "opacity": 5e-2, "color": 2.5e-3}
"""Of Adam; that of the means times the extent of the cameras."""
FINAL = 0.01
"""What is left of the means' rate after the last second."""
OPACITY = 0.1
"""At the start."""
DRAWING = Drawing(Cutoffs(low_pass=0.3))


class PlainGaussians:
    """Free Gaussians: means, quaternions, log scales, opacity logits, colours."""

    def __init__(self, means: np.ndarray, colors: np.ndarray, spacing: np.ndarray) -> None:
        """Take means [N, 3] m, colors [N, 3] sRGB, spacing [N] m: the standard deviation in every direction."""
        n = len(means)
        given = {
            "mean": means,
            "rotation": np.tile([1.0, 0, 0, 0], (n, 1)),
            "scale": np.log(np.repeat(spacing[:, None], 3, axis=1)),
            "opacity": np.full(n, np.log(OPACITY / (1 - OPACITY))),
            "color": colors,
        }
        self.values = {name: torch.tensor(v, dtype=torch.float32, requires_grad=True) for name, v in given.items()}

    def draw(self, camera: Camera) -> Rendering:
        """Its picture."""
        v = self.values
        return rasterize(
            Gaussians(
                v["mean"], rotations(v["rotation"]), torch.exp(v["scale"]), torch.sigmoid(v["opacity"]), v["color"]
            ),
            [camera],
            drawing=DRAWING,
        )


def hull_points(maps: Mapping[int, GaussianMaps], cameras: Mapping[int, Camera]) -> PlainGaussians:
    """Every n-th pixel of the hull's depth maps, in the colour it has there, as wide as the points are apart."""
    lifted = [
        lift(
            maps[v],
            np.asarray(cameras[v].intrinsics),
            np.asarray(cameras[v].world_to_camera),
            torch.float32,
            torch.device("cpu"),
        )
        for v in maps
    ]
    means, colors, widths = (
        np.concatenate([a.numpy() for a in arrays])
        for arrays in zip(*((g.mean, g.color, g.scale[:, 0]) for g in lifted), strict=True)
    )
    step = max(1, len(means) // POINTS)
    chosen = np.random.default_rng(0).permutation(len(means))[::step]
    # Half a pixel is the width of a view's own Gaussians;
    # the views lie on top of one another and one in `step` is left.
    return PlainGaussians(means[chosen], colors[chosen], 2 * widths[chosen] * np.sqrt(step / len(lifted)))


def optimised(
    gaussians: PlainGaussians,
    filmed: Sequence[Filmed],
    extent: float,
    seconds: Sequence[float],
    watch: Callable[[float, PlainGaussians], None],
) -> Iterator[int]:
    """Optimise on all pictures in turn; `watch` sees the Gaussians at each of the CPU `seconds`. Yields the number
    of steps at each."""
    adam = torch.optim.Adam(
        [
            {"params": [v], "lr": RATES[k] * (extent if k == "mean" else 1.0), "name": k}
            for k, v in gaussians.values.items()
        ],
        eps=1e-15,
    )
    order, step, spent = np.random.default_rng(0), 0, 0.0
    for stop in sorted(seconds):
        while spent < stop:
            clock = time.process_time()
            picture = filmed[int(order.integers(len(filmed)))]
            loss(gaussians.draw(picture.camera), picture).backward()
            adam.param_groups[0]["lr"] = RATES["mean"] * extent * FINAL ** min(1.0, spent / max(seconds))
            adam.step()
            adam.zero_grad()
            step, spent = step + 1, spent + time.process_time() - clock
        watch(stop, gaussians)
        yield step
