"""Per-scene 3D Gaussian splatting (`posegaussian.stages.peers.free_gaussians`) by CPU seconds instead of steps, on the
first frame of a run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from posegaussian.dags.planning.results import Results
from posegaussian.stages.peers.free_gaussians import FreeGaussians, optimise, start
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.rendering.clipping import retouched
from posegaussian.stages.rendering.evening import outlines_for
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.rendering.sources import unrefined_arrays
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.silhouettes.softness import softness
from posegaussian.stages.splatting.definition.scene import Camera


@dataclass(frozen=True, eq=False)
class Scene:
    """The first frame of a run with hull depth, as the baseline takes it."""

    results: Results
    cameras: dict[int, Camera]
    masks: dict[int, np.ndarray]
    maps: dict[int, GaussianMaps]
    silhouettes: Silhouettes

    @classmethod
    def of(cls, results: Results) -> Scene:
        """Sources and held-out views of a run with `depth.method=hull`."""
        context, frame = results.context, range(1)
        rig, views = context.rig, context.views
        cameras = {
            v: Camera(rig.intrinsics[v], rig.world_to_camera[v], *(int(n) for n in rig.size[v]))
            for v in (*views.sources, *views.held_out)
        }
        masks = {v: results.read("frames/mask", frame, v)[0] for v in cameras}
        arrays = unrefined_arrays(context.facts)
        maps = {v: GaussianMaps(*(results.read(a, frame, v)[0] for a in arrays)) for v in views.sources}
        return cls(results, cameras, masks, maps, agreed(rig, {v: masks[v] for v in views.sources}))

    def start(self) -> FreeGaussians:
        """Some of the pixels of the hull's depth maps, in the colour they have there."""
        means, colors = [], []
        for v, maps in self.maps.items():
            k, pose = np.asarray(self.cameras[v].intrinsics), np.asarray(self.cameras[v].world_to_camera)
            lifted = lift(maps, k, pose, torch.float32, torch.device("cpu"))
            means.append(lifted.mean.numpy())
            colors.append(lifted.color.numpy())
        centres = self.results.context.rig.centres[list(self.maps)]
        return start(np.concatenate(means), np.concatenate(colors), centres)

    def filmed(self) -> list[Filmed]:
        """The source pictures."""
        out = []
        for v, maps in self.maps.items():
            width, height = self.cameras[v].width, self.cameras[v].height
            cover = self.masks[v][:height, :width].astype(np.float32) / 255
            color = np.asarray(maps.color)[:height, :width].astype(np.float32) / 255 * cover[..., None]
            out.append(Filmed(self.cameras[v], color, cover))
        return out

    def pictures(self, gaussians: FreeGaussians) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """(held-out view, its picture filled, evened, clipped as rendering does, the picture as it is), sRGB 0..1."""
        rig, masks = self.results.context.rig, {v: self.masks[v] for v in self.maps}
        widths = {v: softness([m[: rig.size[v, 1], : rig.size[v, 0]]]) for v, m in masks.items()}
        for v in self.results.context.views.held_out:
            with torch.no_grad():
                drawn = gaussians.draw(self.cameras[v])
            color, alpha = drawn.color[0].numpy(), drawn.alpha[0].numpy()
            outlines = outlines_for(self.cameras[v], rig, self.silhouettes, masks, widths)
            yield (
                v,
                retouched(color, alpha, self.silhouettes, self.cameras[v], 1.0, outlines, self.silhouettes)[0],
                color,
            )


def optimised(
    gaussians: FreeGaussians,
    filmed: Sequence[Filmed],
    seconds: Sequence[float],
    watch: Callable[[float, FreeGaussians], None],
) -> Iterator[int]:
    """Optimise for the longest of the CPU `seconds`; `watch`, whose own time does not count, sees the Gaussians at each
    of them. Yields the number of steps at each."""
    stops, begun, watching = sorted(seconds), time.process_time(), 0.0
    last = stops[-1]

    def spent() -> float:
        return time.process_time() - begun - watching

    for step in optimise(gaussians, filmed, lambda _: spent() / last):
        while stops and spent() >= stops[0]:
            clock = time.process_time()
            watch(stops.pop(0), gaussians)
            watching += time.process_time() - clock
            yield step
