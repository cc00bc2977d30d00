"""What refinement reads of a frame: thinned Gaussians of the source views, and the pictures they should draw."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.contract.reading import read_together
from posegaussian.stages.refinement.params import RefinementParams, pixels_a_gaussian
from posegaussian.stages.refinement.schedule import Schedule, schedule
from posegaussian.stages.refinement.steps.attributes import ViewGaussians
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.refinement.thinning import thinned
from posegaussian.stages.rendering.lift import GaussianMaps
from posegaussian.stages.rendering.sources import map_bytes, unrefined_arrays
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.places import agreed, beyond, lacking
from posegaussian.stages.splatting.definition.scene import Camera


class FrameGaussians(NamedTuple):
    """What is optimised, and on what, by source view that has both."""

    gaussians: dict[int, ViewGaussians]
    filmed: dict[int, Filmed]
    plan: Schedule | None
    """None: too few views."""


class FrameReader:
    """What the task reads, frame by frame and view by view; `i` is a frame of the sequence."""

    def __init__(self, inputs: Inputs, params: RefinementParams) -> None:
        self.inputs, self.every = inputs, pixels_a_gaussian(len(inputs.views.sources), params)
        self.frames: dict[int, dict[int, list[Any]]] = {}
        """{frame: {view: what is read of it}} of what was read last: some of the partition, or a frame before it."""

    def maps(self, i: int, view: int) -> GaussianMaps:
        """As they are before refinement."""
        return GaussianMaps(*self._arrays(i, view)[:-1])

    def _arrays(self, i: int, view: int) -> list[Any]:
        """What Gaussians are lifted from, and the mask."""
        if i not in self.frames:
            own, rig = self.inputs.partition, self.inputs.rig
            frame_bytes = map_bytes(int(rig.size.max(axis=0).prod()), len(self.inputs.views.sources))
            span = read_together(own, i, frame_bytes) if i in own else range(i, i + 1)
            self.frames = {}  # what is read next takes their place
            names = (*unrefined_arrays(self.inputs.facts), "frames/mask")
            read = {v: [self.inputs.read(n, v, span) for n in names] for v in self.inputs.views.sources}
            self.frames = {k: {v: [a[k - span.start] for a in arrays] for v, arrays in read.items()} for k in span}
        return self.frames[i][view]

    def frame(self, i: int) -> FrameGaussians:
        """Thinned Gaussians of the source views that have some, and something to compare with. Whether a frame of
        the halo has a picture is told by its mask."""
        rig, sources = self.inputs.rig, self.inputs.views.sources
        found = {}
        for v in sources:
            maps = thinned(self.maps(i, v), self.every)
            gaussians = ViewGaussians.of(maps, rig.intrinsics[v], rig.world_to_camera[v])
            if len(gaussians) and self._arrays(i, v)[-1].any():
                found[v] = gaussians
        plan = schedule(rig, sources, np.isin(np.arange(len(rig)), list(found)))
        if plan is None:
            return FrameGaussians(found, {}, None)
        silhouettes = agreed(rig, {v: self._arrays(i, v)[-1] for v in sources})
        return FrameGaussians(found, {v: self.filmed(i, v, silhouettes) for v in found}, plan)

    def filmed(self, i: int, view: int, silhouettes: Silhouettes) -> Filmed:
        """The view's picture without the padding."""
        rig = self.inputs.rig
        width, height = (int(n) for n in rig.size[view])
        mask = self._arrays(i, view)[-1][:height, :width]
        cover = mask.astype(np.float32) / 255
        color = np.asarray(self.maps(i, view).color)[:height, :width].astype(np.float32) / 255 * cover[..., None]
        camera = Camera(rig.intrinsics[view], rig.world_to_camera[view], width, height)
        lost = lacking(silhouettes, view, mask) | beyond(silhouettes, view, mask)
        return Filmed(camera, color, cover, lost if lost.any() else None)
