"""One round of semi-global matching: all rectified pairs, row by row, in both directions."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.depth.algorithms.scene import Geometry, Maps
from posegaussian.stages.depth.algorithms.search import SearchSettings
from posegaussian.stages.matching.bounds import Bounds
from posegaussian.stages.matching.fuse import fuse, transfer
from posegaussian.stages.matching.sampling import disagreement
from posegaussian.stages.matching.sgbm import match


def in_rows(
    geometry: Geometry,
    colors: dict[int, np.ndarray],
    inside: dict[int, np.ndarray],
    bounds: dict[int, Bounds],
    params: SearchSettings,
    checked: bool,
    paths: int,
) -> Maps:
    """Depth and confidence by view [h, w] float32 of matching all rectified pairs in both directions, 0 where there is
    none: what holds in both (unless `checked`, all), fused by view.

    `colors` [h, w, 3] uint8, `inside` [h, w] bool and `bounds` of every view, `paths` of
    `posegaussian.stages.matching.sgbm.match`.
    """
    found = {
        (a, b): match(pair, colors[a], colors[b], inside[a], bounds[a], paths)
        for (a, b), pair in geometry.pairs.items()
    }
    out = {}
    for v in geometry.views:
        partners = geometry.partners(v)
        if not partners:
            out[v] = (np.zeros_like(bounds[v].guide), np.zeros_like(bounds[v].guide))
            continue
        scales = np.array([geometry.pairs[v, b].sensitivity for b in partners])
        errors = [_errors(geometry, found, v, b, s, checked) for b, s in zip(partners, scales, strict=True)]
        out[v] = fuse(np.stack([found[v, b] for b in partners]), np.stack(errors), scales, params.consistency)
    return out


def _errors(
    geometry: Geometry, found: dict[tuple[int, int], np.ndarray], view: int, partner: int, scale: float, checked: bool
) -> np.ndarray:
    """[h, w] px by which the partner contradicts a view's matches, infinite without one; 0 for every match unless
    `checked`."""
    if checked:
        return disagreement(found[view, partner], found[partner, view], transfer(geometry.rig, view, partner), scale)
    return np.where(found[view, partner] > 0, 0.0, np.inf).astype(np.float32)
