"""What refinement writes as lists of Gaussians, as maps of pixels and back: laws are said of pixels."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posegaussian.stages.refinement.run import _arrays, _stacked
from posegaussian.stages.rendering.lift import GaussianMaps, from_list
from posegaussian.stages.rendering.sources import COUNTS, REFINED
from posegaussian.storage.model.cameras import Rig


def as_maps(out: Mapping[str, np.ndarray], rig: Rig) -> dict[str, np.ndarray]:
    """{name of `REFINED` but the pixel: [F, V, ...] maps}, 0 where there is no Gaussian."""
    height, found = int(rig.size[:, 1].max()), []
    for i, own in enumerate(out[COUNTS]):
        for v, n in enumerate(own):
            maps = from_list([out[name][i, v, :n] for name in REFINED], rig).spread(height)
            found.append([maps.color, maps.depth, *maps.channels()])
    frames = out[COUNTS].shape
    return {
        name: np.stack(arrays).reshape(*frames, *arrays[0].shape)
        for name, arrays in zip(REFINED[:-1], zip(*found, strict=True), strict=True)
    }


def as_lists(maps: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What refinement writes of such maps [F, V, ...]."""
    frames, views = maps["refinement/depth"].shape[:2]
    every = [GaussianMaps(*(maps[n][i, v] for n in REFINED[:-1])).listed() for i in range(frames) for v in range(views)]
    counts = np.array([np.shape(g.depth)[1] for g in every], np.int32)
    lists = (_stacked(arrays) for arrays in zip(*(_arrays(g) for g in every), strict=True))
    return {COUNTS: counts.reshape(frames, views)} | {
        name: a.reshape(frames, views, *a.shape[1:]) for name, a in zip(REFINED, lists, strict=True)
    }
