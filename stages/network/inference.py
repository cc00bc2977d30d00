"""What the network says of every source view of a frame: pairs are rectified, looked at, and pulled back onto the
views' own pixels.

Only changes are pulled back, not values: where the network says nothing, a view's depth stays what it was, bit by bit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from posegaussian.stages.geometry.pairs import choose_pairs, pair_report
from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.geometry.rectification import RectifiedPair, Window, rectify
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.stages.geometry.turning import common_turn, turn_in_picture
from posegaussian.stages.imaging.part import part_around
from posegaussian.stages.network.model.network import PoseGaussianNetwork, Prediction, Timer
from posegaussian.stages.network.model.pairs import (
    PairViews,
    SourceView,
    rectified_pair,
    single_view,
    too_large,
    window_around,
    windows,
)
from posegaussian.stages.network.model.presets import LONELY_ANGLE, TRAINED_ANGLE, TRAINED_SIDE, Preset
from posegaussian.stages.network.single_view import beside, single_pair
from posegaussian.stages.network.third_view import candidates, third_of
from posegaussian.storage.model.cameras import Rig, points_to_integer_centres

HEADS = ("scale", "rotation", "opacity")
"""In the order of the channels of `network/numbers`."""
NUMBERS = 8
"""Channels of `network/numbers`."""
SEEN = 0.5
"""Share of a pixel's surroundings in the rectified window that must have a start."""
FURTHEST = 0.25
"""Share by which inverse depth may change: half a body at any distance a person is filmed from."""


@dataclass(frozen=True, eq=False)
class Learned:
    """Of one view, on its own pixels; 0 where nothing is said."""

    inverse_depth: np.ndarray
    """[h, w] float32 change of 1 / depth, 1/m, its share already in it."""
    confidence: np.ndarray
    """[h, w] float32 probability that the learned depth is nearer to the truth than the start."""
    share: np.ndarray
    """[h, w] float32 of what the heads say of scale, rotation and opacity."""
    numbers: np.ndarray
    """[n, h, w] float32 of the heads, as many as the network's have."""

    def of_whole(self, part: tuple[slice, slice], shape: tuple[int, ...]) -> Learned:
        """The same of a picture [h, w] of which this is a part."""
        return Learned(*(_spread(m, part, shape) for m in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Looks:
    """Which pairs of some views are looked at; follows from the cameras alone."""

    rig: Rig
    """The cameras."""
    pairs: tuple[RectifiedPair, ...]
    thirds: tuple[tuple[int, ...], ...]
    """Of each pair, the views that could be its third, the best one first."""
    axes: Mapping[int, float]
    """Of each view, the turn in its picture (radians, from x towards y) of the axes along which sizes and normals are
    said: what its pairs have in common, or 0, the picture's own."""

    @classmethod
    def of(
        cls, rig: Rig, views: tuple[int, ...], count: int, widest: float = TRAINED_ANGLE, turned: bool = False
    ) -> Looks:
        """Each view with its `count` nearest usable neighbours, every pair once; none of more than `widest` degrees,
        beyond what the network was trained on: where a real pair stood 65 apart and the widest trained on 60, both
        views' depths agreed on 13 % fewer pixels with it than without. But a view without a pair gets its nearest, up
        to `LONELY_ANGLE`. `turned`: whether axes may be turned in their pictures."""
        reports = pair_report(rig, views, widest)
        partners = choose_pairs(rig, views, count, reports=reports)
        if not all(partners.values()):
            nearest = choose_pairs(rig, views, 1, reports=pair_report(rig, views, max(widest, LONELY_ANGLE)))
            partners = {v: found or nearest[v] for v, found in partners.items()}
        seeing = rig.subset(views)
        centre, up = look_at_point(seeing), up_direction(seeing)
        scale = _scale(rig, views)
        unordered = sorted({(min(a, b), max(a, b)) for a, found in partners.items() for b in found})
        pairs = tuple(rectify(rig, a, b, centre, scale, up) for a, b in unordered)
        turns: dict[int, list[float]] = {v: [] for v in views}
        for pair in pairs if turned else ():
            for which, view in enumerate(pair.views):
                turns[view].append(turn_in_picture(rig, pair, which))
        axes = {view: common_turn(found) for view, found in turns.items()}
        return cls(rig, pairs, tuple(candidates(rig, pair, reports) for pair in pairs), axes)

    def sensitivity(self, view: int) -> float:
        """Px of disparity for 1/metre of inverse depth in the view's pair that moves most; 0 without one."""
        return max((p.sensitivity for p in self.pairs if view in p.views), default=0.0)

    def along_axes(self, learned: Learned, pair: RectifiedPair, which: int, first: int) -> Learned:
        """What was said along the axes of a pair, along those of its view."""
        return along(learned, turn_in_picture(self.rig, pair, which) - self.axes[pair.views[which]], first)


def _scale(rig: Rig, views: tuple[int, ...]) -> float:
    """Of the pictures that are looked at."""
    return min(1.0, TRAINED_SIDE / float(rig.size[list(views)].max()))


def look_alone(
    network: PoseGaussianNetwork,
    rig: Rig,
    view: int,
    shown: SourceView,
    iterations: int,
    precision: str,
    timer: Timer | None = None,
    left_out: Counter[int] | None = None,
) -> Learned | None:
    """What is learnt about a view without a partner, whose start is a relief; None where it shows nobody. `timer` and
    `left_out` as in `look`."""
    clock = timer or (lambda name: nullcontext())
    with clock("rectification"):
        pair = single_pair(rig, view, look_at_point(rig.subset([view])), _scale(rig, (view,)))
        window = window_around(pair, shown.depth > 0, network.preset.stride)
        if window is None or too_large(pair, window):
            _count(left_out, (view,), window)
            return None
        rectified = single_view(pair, shown, (window, beside(pair, window)), network.joints)
    prediction = predict(network, rectified, iterations, precision, timer)
    with clock("pulling back"):
        said = learned_of(pair, 0, window, rectified, prediction, shown.depth)
        return along(said, turn_in_picture(rig, pair, 0), leaning(network.preset))


def look(
    network: PoseGaussianNetwork,
    looks: Looks,
    views: Mapping[int, SourceView],
    iterations: int,
    precision: str,
    timer: Timer | None = None,
    left_out: Counter[int] | None = None,
) -> dict[int, Learned]:
    """What is learnt about every view that has a pair;
    `timer` is told of `rectification`, the network's modules and `pulling back`, and `left_out` counts, by view, the
    pairs that were not looked at as too large."""
    clock = timer or (lambda name: nullcontext())
    found: dict[int, list[Learned]] = {}
    parts = {v: part_around(shown.depth > 0, 0) for v, shown in views.items()}
    for pair, thirds in zip(looks.pairs, looks.thirds, strict=True):
        shown = (views[pair.views[0]], views[pair.views[1]])
        with clock("rectification"):
            around = windows(pair, (shown[0].depth > 0, shown[1].depth > 0), network.preset.stride)
            if around is None or too_large(pair, around[0]):
                _count(left_out, pair.views, around)
                continue
            rectified = rectified_pair(pair, shown, around, joints=network.joints)
            if network.preset.further_views:
                rectified = replace(
                    rectified,
                    third=third_of(
                        looks.rig, pair, around, {v: views[v] for v in thirds}, network.preset.stride, network.joints
                    ),
                )
        prediction = predict(network, rectified, iterations, precision, timer)
        with clock("pulling back"):
            for which, view in enumerate(pair.views):
                part = parts[view]
                corner = part[0].start, part[1].start
                said = learned_of(pair, which, around[which], rectified, prediction, shown[which].depth[part], corner)
                found.setdefault(view, []).append(looks.along_axes(said, pair, which, leaning(network.preset)))
    with clock("pulling back"):
        return {v: _merged(said).of_whole(parts[v], views[v].depth.shape) for v, said in found.items()}


def _count(left_out: Counter[int] | None, views: tuple[int, ...], window: object | None) -> None:
    """Count views whose pair has a window and is not looked at."""
    if left_out is not None and window is not None:
        left_out.update(views)


def predict(
    network: PoseGaussianNetwork, views: PairViews, iterations: int, precision: str, timer: Timer | None = None
) -> Prediction:
    """One forward pass without gradients, on the device that the network lies on; what it says is where the views are.

    `timer` is told of a device's work when it is handed out, not when it is done.
    """
    views, home = views.to(network.device), views.color.device
    with torch.inference_mode(), torch.autocast(network.device.type, torch.bfloat16, enabled=precision == "bf16"):
        return network(views, iterations, only_last=True, timer=timer).to(home)


def refined(depth: np.ndarray, learned: Learned) -> np.ndarray:
    """Depth [h, w] float32, metres, with the change of its inverse;
    0 stays 0, and what is not finite changes nothing."""
    known = depth > 0
    inverse = 1 / np.where(known, depth, 1).astype(np.float64)
    change = np.nan_to_num(learned.inverse_depth.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    moved = inverse + np.clip(change, -FURTHEST * inverse, FURTHEST * inverse)
    return np.where(known & (change != 0), 1 / moved, depth).astype(np.float32)


def learned_of(
    pair: RectifiedPair,
    which: int,
    window: Window,
    views: PairViews,
    prediction: Prediction,
    depth: np.ndarray,
    corner: tuple[int, int] = (0, 0),
) -> Learned:
    """One direction of a pair on its view's own pixels [h, w], those with a depth. `depth` may be a part of the view's;
    its first pixel is in row and column `corner`."""
    rectified, ratio = pair.rectified_pixels(which, pixel_centres(depth.shape[::-1]) + corner[::-1])
    x, y = (
        np.ascontiguousarray(m)
        for m in np.moveaxis(points_to_integer_centres(rectified - np.array(window[:2])).astype(np.float32), -1, 0)
    )
    known = views.known[which, 0].numpy()
    move = np.where(
        known, torch.where(views.known, prediction.disparity - views.start, 0)[which, 0].numpy(), 0
    ) / float(views.coding.scale[which])
    heads = torch.cat([prediction.numbers[name][which] for name in HEADS]).numpy()
    maps = [move, prediction.confidence[which, 0].numpy(), prediction.shares[which, 1].numpy(), *heads]
    share = cv2.remap(known.astype(np.float32), x, y, cv2.INTER_LINEAR)
    told = (share > SEEN) & (depth > 0) & (ratio > 0)
    pulled = [
        np.where(
            told,
            cv2.remap(np.where(known, m, 0).astype(np.float32), x, y, cv2.INTER_LINEAR) / np.where(told, share, 1),
            0,
        ).astype(np.float32)
        for m in maps
    ]
    return Learned(pulled[0] * np.where(told, ratio, 0).astype(np.float32), pulled[1], pulled[2], np.stack(pulled[3:]))


def leaning(preset: Preset) -> int:
    """Which of the heads' numbers is the first of the two that lean a normal: a quaternion's turn comes before."""
    return 4 if preset.rotation_head == "quaternion" else 3


def along(learned: Learned, turn: float, first: int) -> Learned:
    """What is said along two axes that are turned by `turn` radians, from x towards y, along the axes themselves.

    Sizes are mixed by the share of each axis in the other: exact for quarter turns, and the less so the nearer a turn
    is to an eighth (`common_turn` leaves none of those). Normals lean towards (x, -y), and the vectors of whole
    rotations are turned alike; `first` as `leaning` says.
    """
    c, s = np.float32(np.cos(turn)), np.float32(np.sin(turn))
    said, numbers = learned.numbers, learned.numbers.copy()
    numbers[0], numbers[1] = c * c * said[0] + s * s * said[1], s * s * said[0] + c * c * said[1]
    numbers[first], numbers[first + 1] = c * said[first] + s * said[first + 1], c * said[first + 1] - s * said[first]
    return replace(learned, numbers=numbers)


def _spread(values: np.ndarray, part: tuple[slice, slice], shape: tuple[int, ...]) -> np.ndarray:
    """Values [..., h, w] of a part of a picture, 0 beside it."""
    out = np.zeros((*values.shape[:-2], *shape), values.dtype)
    out[..., *part] = values
    return out


def _merged(parts: list[Learned]) -> Learned:
    """What several pairs say, averaged by their confidence."""
    if len(parts) == 1:
        return parts[0]
    weights = np.stack([p.confidence for p in parts])
    total = weights.sum(axis=0)
    weights = weights / np.where(total > 0, total, 1)
    numbers = sum(w * p.numbers for w, p in zip(weights, parts, strict=True))
    inverse, confidence, share = (
        (weights * np.stack([getattr(p, name) for p in parts])).sum(axis=0)
        for name in ("inverse_depth", "confidence", "share")
    )
    return Learned(inverse, confidence, share, np.asarray(numbers, np.float32))
