"""A person of capsules, ready for steps of refinement."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.refinement.params import EVERY
from posegaussian.stages.refinement.steps.attributes import ViewGaussians
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.refinement.thinning import thinned
from posegaussian.stages.rendering.lift import GaussianMaps
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture
from posegaussian.stages.splatting.definition.scene import Camera


def begun(c: PersonCapture) -> tuple[dict[int, ViewGaussians], dict[int, Filmed], tuple[int, ...]]:
    """What a walk over all source views of the first frame begins with."""
    views = c.views.sources
    return {v: gaussians(c, v) for v in views}, {v: filmed(c, v) for v in views}, views


def gaussians(c: PersonCapture, view: int) -> ViewGaussians:
    """Thinned, of the first frame."""
    depth = c.depth[0, view]
    ones, there = np.ones((2, *depth.shape), np.float16), (depth > 0).astype(np.float16)
    normal = np.stack([0 * there, 0 * there, -there])
    scale = (0.01 * np.ones((3, *depth.shape))).astype(np.float16)
    maps = GaussianMaps(c.color[0, view], depth, scale, normal, ones * there)
    return ViewGaussians.of(thinned(maps, EVERY), c.rig.intrinsics[view], c.rig.world_to_camera[view])


def filmed(c: PersonCapture, view: int) -> Filmed:
    """The first frame's picture."""
    width, height = (int(n) for n in c.rig.size[view])
    cover = c.mask[0, view].astype(np.float32) / 255
    camera = Camera(c.rig.intrinsics[view], c.rig.world_to_camera[view], width, height)
    return Filmed(camera, c.color[0, view].astype(np.float32) / 255 * cover[..., None], cover)
