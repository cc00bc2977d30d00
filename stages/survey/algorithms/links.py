"""What two cameras both see: features, and outermost points of the outlines of masks, which must lie on each other's
epipolar lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from posegaussian.stages.contract.facts import MASKS
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.geometry.epipolar import fundamental, homogeneous, signed_epipolar_distance
from posegaussian.stages.geometry.matches import epipolar_fit
from posegaussian.stages.geometry.points import to_frames
from posegaussian.stages.imaging.small_turns import KINDS, MOST, POINTS
from posegaussian.stages.silhouettes.tangents import outline, touching
from posegaussian.stages.survey.algorithms.look import NO_FRAMES
from posegaussian.stages.survey.algorithms.sample import compared_numbers, sample_numbers
from posegaussian.stages.survey.algorithms.surface import Seen, later, seen, shared
from posegaussian.storage.model.cameras import Rig

Outline = tuple[np.ndarray, np.ndarray]
FRAMES = 5
"""Sampled frames in which cameras are compared."""


class Both(NamedTuple):
    """What two cameras both see."""

    first: np.ndarray
    """[n, 2] px of the rig, in the first."""
    second: np.ndarray
    """[n, 2] in the second."""
    off: float
    """Median px by which they miss their lines; 0 of nothing."""


NOTHING = Both(np.zeros((0, 2)), np.zeros((0, 2)), 0.0)


class InCommon(NamedTuple):
    """What a pair of cameras shares."""

    features: Both
    outlines: Both


def in_common(
    inputs: Inputs, view: int, numbers: np.ndarray, own: Mapping[int, Seen] | None = None
) -> dict[int, InCommon]:
    """What a source view shares with each later one, of a few of the sampled source frames `numbers` [n]; `own`: what
    is known of the view's own pictures, by frame."""
    others, matched, few = later(inputs, view), compared_numbers(numbers), few_of(numbers)
    masked = MASKS in inputs.facts and bool(others)
    outlines = {v: _outlines(inputs, v, few) for v in (view, *others)} if masked else {}
    return {
        v: InCommon(_features(inputs, (view, v), matched, own or {}), _touching(inputs.rig, (view, v), outlines))
        for v in others
    }


def few_of(numbers: np.ndarray) -> np.ndarray:
    """Some of the sampled source frames."""
    return sample_numbers(numbers, FRAMES) if len(numbers) else NO_FRAMES


def links_of_view(rig: Rig, view: int, pairs: Mapping[int, InCommon]) -> np.ndarray:
    """survey/links [V, POINTS, 4] float32 of a view: directions (x, y) in the axes of both cameras of at most `MOST`
    points of a kind, evenly spread over how far they miss their lines, so that their median stays; 0 for none."""
    out = np.zeros((len(rig), len(KINDS), MOST, 4), np.float32)
    for v, pair in pairs.items():
        for kind, name in enumerate(KINDS):
            first, second, _ = getattr(pair, name)
            if not len(first):
                continue
            order = np.argsort(signed_epipolar_distance(fundamental(rig, view, v), first, second), kind="stable")
            kept = order[np.unique(np.linspace(0, len(order) - 1, min(len(order), MOST)).round().astype(int))]
            directions = [
                (homogeneous(pixels[kept]) @ np.linalg.inv(rig.intrinsics[c]).T)[:, :2]
                for c, pixels in ((view, first), (v, second))
            ]
            out[v, kind, : len(kept)] = np.concatenate(directions, axis=1)
    return out.reshape(len(rig), POINTS, 4)


def _features(inputs: Inputs, pair: tuple[int, int], numbers: np.ndarray, own: Mapping[int, Seen]) -> Both:
    """The right ones of the features that two cameras share; nothing where none can be held for right."""
    found, longest = [], float(inputs.rig.size[list(pair)].max())
    for number in map(int, numbers):
        first = own.get(number) or seen(inputs, pair[0], number)
        second = seen(inputs, pair[1], number) if first is not None else None
        if first is not None and second is not None:
            both = shared(inputs, pair, number, first, second)
            found.append(np.concatenate([p[both.mapped] for p in both.pixels], axis=1))
    points = np.concatenate(found) if found else np.zeros((0, 4))
    # What stands still is matched in every frame at the same place; it counts once.
    _, once = np.unique(points.round(0), axis=0, return_index=True)
    points = points[np.sort(once)]
    fit = epipolar_fit(fundamental(inputs.rig, *pair), points[:, :2], points[:, 2:], longest)
    return NOTHING if fit.error is None else Both(points[fit.agree, :2], points[fit.agree, 2:], fit.error)


def _outlines(inputs: Inputs, view: int, numbers: np.ndarray) -> dict[int, Outline]:
    """Outlines of a view's masks by source frame, px of the rig."""
    had = set(map(int, inputs.source("pictures").numbers(view)))
    chosen, found = [n for n in map(int, numbers) if n in had], {}
    for number, mask in zip(chosen, inputs.source("masks").read(view, chosen) if chosen else (), strict=True):
        corners, free = outline(mask)
        crop = inputs.captured_to_calibrated[view]
        pixels, mapped = to_frames(corners, crop, inputs.source_rig, inputs.rig, view)
        found[number] = pixels[mapped], free[mapped]
    return found


def _touching(rig: Rig, pair: tuple[int, int], outlines: Mapping[int, Mapping[int, Outline]]) -> Both:
    """The outermost points of two cameras' outlines, of every side that both see."""
    if not outlines:
        return NOTHING
    first, second = (outlines[v] for v in pair)
    touched = [touching(rig, pair, first[n], second[n]) for n in sorted(first.keys() & second.keys())]
    if not any(len(x) for x, _ in touched):
        return NOTHING
    x, y = (np.concatenate(points) for points in zip(*touched, strict=True))
    return Both(x, y, float(np.median(np.abs(signed_epipolar_distance(fundamental(rig, *pair), x, y)))))
