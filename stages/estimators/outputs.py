"""A described network's outputs read: places in the region, peaks, and maps laid over the region's 64 x 64 grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.stages.estimators.decoding import sigmoid
from posegaussian.stages.estimators.description import Description
from posegaussian.stages.estimators.interface import MAP_SIDE
from posegaussian.stages.estimators.peaks import LEAST, bin_peaks, heatmap_peaks
from posegaussian.stages.imaging.regions import crop_to_own, own_to_crop
from posegaussian.storage.model.cameras import points_from_integer_centres, points_to_integer_centres


@dataclass(frozen=True, eq=False)
class OutputReading:
    """J joints of one region."""

    places: np.ndarray
    """[J, 2] in the region's own coordinates, 0..1."""
    peaks: np.ndarray
    """[J] values of the peaks, as the network gives them."""
    maps: np.ndarray
    """[J, 64, 64] float32 over the region, largest value 1; zero where the crop does not reach."""


def read_heatmaps(raw: np.ndarray, description: Description, share: np.ndarray) -> OutputReading:
    """Heatmaps [J, h, w] over a crop that is `share` (across, down) of its region."""
    maps = np.maximum(sigmoid(raw) if description.values == "logits" else raw, 0)
    cells, peaks = heatmap_peaks(maps)
    counts = np.array(maps.shape[:0:-1])
    across, down = _grids(counts, description, share)
    return OutputReading(
        crop_to_own(_to_shares(cells, counts, description), share), peaks, _unit(down @ maps @ across.T)
    )


def read_simcc(along_x: np.ndarray, along_y: np.ndarray, description: Description, share: np.ndarray) -> OutputReading:
    """Bins [J, n] along the crop's width and [J, m] along its height; a peak's value is the lesser of the two, a map
    their outer product."""
    logs = [b if description.values == "logits" else np.log(np.maximum(b, LEAST)) for b in (along_x, along_y)]
    counts = np.array([along_x.shape[1], along_y.shape[1]])
    cells = np.stack([bin_peaks(b) for b in logs], axis=1)
    weights = [np.exp(b - b.max(1, keepdims=True)) for b in logs]
    across, down = _grids(counts, description, share)
    maps = (weights[1] @ down.T)[:, :, None] * (weights[0] @ across.T)[:, None, :]
    return OutputReading(
        crop_to_own(_to_shares(cells, counts, description), share),
        np.minimum(along_x.max(1), along_y.max(1)),
        _unit(maps),
    )


def _steps(counts: np.ndarray, description: Description) -> np.ndarray:
    """[2] px of the input between cells."""
    size = np.array(description.input, dtype=np.float64)
    return (size - 1) / (counts - 1) if description.cells == "corners" else size / counts


def _to_shares(cells: np.ndarray, counts: np.ndarray, description: Description) -> np.ndarray:
    """Places [..., 2] in cells -> shares 0..1 of the crop, by what a cell means to the network."""
    if description.cells == "centre":
        return points_from_integer_centres(cells) / counts
    return points_from_integer_centres(cells * _steps(counts, description)) / description.input


def _to_cells(shares: np.ndarray, counts: np.ndarray, description: Description) -> np.ndarray:
    """The inverse of `_to_shares`."""
    if description.cells == "centre":
        return points_to_integer_centres(shares * counts)
    return points_to_integer_centres(shares * description.input) / _steps(counts, description)


def _grids(counts: np.ndarray, description: Description, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrices [64, w] and [64, h] that interpolate cells at the centres of the region's grid, across and down;
    coarser grids average."""
    centres = points_from_integer_centres(np.repeat(np.arange(MAP_SIDE)[:, None], 2, axis=1)) / MAP_SIDE
    at = _to_cells(own_to_crop(centres, share), counts, description)
    return _hats(at[:, 0], int(counts[0])), _hats(at[:, 1], int(counts[1]))


def _hats(at: np.ndarray, count: int) -> np.ndarray:
    width = max(1.0, float(at[1] - at[0]))
    return (np.maximum(0, 1 - np.abs(at[:, None] - np.arange(count)) / width) / width).astype(np.float32)


def _unit(maps: np.ndarray) -> np.ndarray:
    """Maps [J, h, w] with largest value 1; one without any weight stays zero."""
    top = maps.max((1, 2), keepdims=True)
    return np.divide(maps, top, out=np.zeros_like(maps), where=top > 0).astype(np.float32)
