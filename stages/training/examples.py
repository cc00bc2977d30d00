"""What a step is given: crops of pairs of views, or of views alone, around the same point of the body, the truth, and a
picture from between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
import torch

from posegaussian.stages.geometry.pairs import classify
from posegaussian.stages.geometry.projection import pixel_centres, project
from posegaussian.stages.geometry.rectification import RectifiedPair, Window, rectify
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.stages.network.model.pairs import (
    PairViews,
    SourceView,
    Third,
    places,
    rectified_pair,
    single_view,
    start_on,
    window_around,
    windows,
)
from posegaussian.stages.network.single_view import beside, single_pair
from posegaussian.stages.network.third_view import candidates, finer, intrinsics_of, third_view
from posegaussian.stages.network.third_view import window_around as third_window
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.stages.training.augmentation import misplacement, shifted, spoilt, spoilt_third
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.joint_clips import EXACT, Marks, found, heatmaps_of, marks_drawn
from posegaussian.stages.training.starts import Kind, Start, kind_drawn, relief_start, start_of
from posegaussian.stages.training.things import thing
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import foreground

HARD = 0.4
"""Share of the crops that lie around a pixel whose start is more than a px off."""
TINT = 0.08
"""Largest change of a colour channel's gain, the same in both views and the target."""
WITHOUT_THIRD = 0.2
"""Share of the crops without a third view, where a network of such is trained: pairs of small rigs have none."""
KINDS_OF_STRANGE = 3
"""Pictures that do not fit, somebody else's, and things that are no person: each has its part of `config.strange`."""
Frame = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Example:
    """One pair of views, or two views alone."""

    views: PairViews
    """Both directions."""
    truth: torch.Tensor
    """[2, 1, H, W] true disparity, px, NaN where there is none."""
    cameras: tuple[Camera, Camera]
    """Of both rectified windows."""
    picture: torch.Tensor
    """[2, H, W, 3] the rectified pictures as the Gaussians take them, sRGB 0..1."""
    target: Camera
    """A held-out camera between both views, cropped."""
    seen: torch.Tensor
    """[1, 3, h, w] what it sees, premultiplied."""
    cover: torch.Tensor
    """[1, 1, h, w] its mask, 0..1."""
    strange: bool
    """Whether nothing can be learnt here about depth: the two pictures do not fit, or what they show is no person."""


class Side(NamedTuple):
    """One direction of an example."""

    view: int
    """Of the frame."""
    pair: RectifiedPair
    which: int
    """Which of its views this is."""
    window: Window
    other: Window
    """Of the pair's other view."""


class Further(NamedTuple):
    """The third view of an example."""

    view: int
    """Of the frame."""
    window: Window
    """In pixels as fine as the pair's."""
    random: np.random.Generator | None
    """Of what is done to it alone; None: nothing is."""


class Spoiling(NamedTuple):
    """What is done to a crop; a whole pair is shown as it is."""

    random: np.random.Generator
    gain: np.ndarray
    """[3] of the colour channels."""
    misplaced: float
    """Rows by which the second picture is shifted so that nothing fits; 0: it is not."""


def frames_of_step(config: TrainingConfig, step: int) -> range:
    """Training frames at hand for a step, counted from 0:
    a window that moves on by a frame every `steps_per_frame` steps."""
    first = step // config.steps_per_frame
    return range(first, first + config.window)


def drawn(config: TrainingConfig, step: int, frames: Mapping[int, Frame]) -> tuple[list[Example], int]:
    """The examples of a step and its number of iterations: they follow from (config.seed, step) alone."""
    random = np.random.default_rng([config.seed, step])
    at_hand = frames_of_step(config, step)
    examples = [crop(frames[at_hand[int(random.integers(len(at_hand)))]], config, random) for _ in range(config.batch)]
    examples = exchanged(examples, config.strange / KINDS_OF_STRANGE, random)
    return examples, int(random.integers(1, config.iterations + 1))


def exchanged(examples: Sequence[Example], share: float, random: np.random.Generator) -> list[Example]:
    """The same examples, but such a share of them shows, in its second view or both, another example's pictures within
    its own outline."""
    out = list(examples)
    for i, example in enumerate(examples):
        if len(examples) > 1 and random.random() < share:
            other = examples[(i + 1 + int(random.integers(len(examples) - 1))) % len(examples)].views.color
            views, keep = example.views, random.random() < 0.5
            color = other * views.cover
            color = torch.stack([views.color[0] if keep else color[0], color[1]])
            out[i] = replace(example, views=replace(views, color=color), strange=True)
    return out


def crop(frame: Frame, config: TrainingConfig, random: np.random.Generator) -> Example:
    """A pair of a frame, cut out around a point that the first view sees, or its two views each alone; and a third view
    cut out around the same where the network looks at one.

    What concerns the third view alone is drawn from a generator of its own: all else is the same with it and without.
    """
    views = tuple(int(v) for v in frame["pairs"][random.integers(len(frame["pairs"]))])
    a, b, between = (views[1], views[0], views[2]) if random.random() < 0.5 else views
    alone, kind = random.random() < config.single, kind_drawn(config.starts, random)
    strange = int(random.random() / max(config.strange, 1e-12) * KINDS_OF_STRANGE)  # 0, 1, or more: fits
    if strange == 1:
        frame, (a, b, between) = thing(frame, (a, b, between), _centre(frame), random), (0, 1, 2)
    rig, centre, side = _rig(frame), _centre(frame), config.crop
    pair = rectify(rig, a, b, centre)
    starts = _starts(frame, (a, b), pair.sensitivity, None if alone else kind, random)
    point = _world(frame, a, *_point(frame["truth"][a], starts[0].depth, pair.sensitivity, random))
    off = random.uniform(-side / 8, side / 8, 2)
    sides = _sides(rig, (a, b), pair, centre, point, off, side, alone)
    misplaced = misplacement(side, random) if strange == 0 and not alone else 0.0
    spoiling = Spoiling(random, 1 + random.uniform(-TINT, TINT, 3), misplaced)
    marks = marks_drawn(config.stabilisers, random)
    further = None
    if config.further_views:
        own = random.spawn(1)[0]
        further = None if alone else _further_at(frame, pair, point, side, own)
    found = _example(frame, sides, starts, _target(frame, between, point, side // 2), between, marks, spoiling, further)
    return replace(found, strange=misplaced != 0 or strange == 1)


def whole(frame: Frame, row: int, config: TrainingConfig, kind: Kind = "matched") -> Example:
    """A pair of a frame without a crop, as inference sees it."""
    a, b, between = (int(v) for v in frame["pairs"][row])
    rig, multiple = _rig(frame), config.network().stride
    pair = rectify(rig, a, b, _centre(frame))
    around = windows(pair, (frame["depth"][a] > 0, frame["depth"][b] > 0), multiple)
    assert around is not None, "a training frame without a subject"
    further = None
    for view in _others(frame, pair) if config.further_views else ():
        window = third_window(frame["depth"][view] > 0, finer(rig, pair, view), multiple)
        if window is not None:
            further = Further(view, window, None)
            break
    sides = Side(a, pair, 0, *around), Side(b, pair, 1, around[1], around[0])
    starts = _starts(frame, (a, b), pair.sensitivity, kind, np.random.default_rng(0))
    return _example(frame, sides, starts, _target(frame, between, None, 0), between, EXACT, None, further)


def whole_alone(frame: Frame, row: int, config: TrainingConfig) -> Example:
    """The views of a pair of a frame, each alone and without a crop, over its relief; in windows of one size."""
    a, b, between = (int(v) for v in frame["pairs"][row])
    rig, centre, multiple = _rig(frame), _centre(frame), config.network().stride
    pairs = [single_pair(rig, v, centre) for v in (a, b)]
    found = [window_around(p, frame["depth"][v] > 0, multiple) for p, v in zip(pairs, (a, b), strict=True)]
    width, height = (max(w[i] for w in found if w is not None) for i in (2, 3))
    around = [(w[0], w[1], width, height) for w in found if w is not None]
    sides = [Side(v, p, 0, w, beside(p, w)) for v, p, w in zip((a, b), pairs, around, strict=True)]
    starts = _starts(frame, (a, b), pairs[0].sensitivity, None, np.random.default_rng(0))
    target = _target(frame, between, None, 0)
    return _example(frame, (sides[0], sides[1]), starts, target, between, EXACT, None, None)


def crop_of_thing(frame: Frame, row: int, config: TrainingConfig) -> Example:
    """A whole pair with a thing that is no person in its place, always the same one."""
    a, b, between = (int(v) for v in frame["pairs"][row])
    found = thing(frame, (a, b, between), _centre(frame), np.random.default_rng(row))
    return replace(whole(found, 0, config), strange=True)


def _sides(
    rig: Rig,
    views: tuple[int, int],
    pair: RectifiedPair,
    centre: np.ndarray,
    point: np.ndarray,
    off: np.ndarray,
    side: int,
    alone: bool,
) -> tuple[Side, Side]:
    """Windows of `side` px about a point [3], which lies `off` [2] px from their middle."""

    def corner(pair: RectifiedPair, which: int) -> np.ndarray:
        place = project(point[None], pair.intrinsics[which], pair.world_to_camera(which))[0][0]
        return np.round(place + off - side / 2).astype(int)

    if alone:
        found = []
        for view in views:
            own = single_pair(rig, view, centre)
            x, y = corner(own, 0)
            window = (int(x), int(y), side, side)
            found.append(Side(view, own, 0, window, beside(own, window)))
        return found[0], found[1]
    corners = [corner(pair, w) for w in (0, 1)]
    first, second = ((int(c[0]), int(corners[0][1]), side, side) for c in corners)
    return Side(views[0], pair, 0, first, second), Side(views[1], pair, 1, second, first)


def _starts(
    frame: Frame, views: tuple[int, int], sensitivity: float, kind: Kind | None, random: np.random.Generator
) -> tuple[Start, Start]:
    """Of both views; None: the reliefs of views alone."""
    if kind is None:
        first, second = (
            relief_start(frame["mask"][v], frame["truth"][v], float(frame["intrinsics"][v, 0, 0])) for v in views
        )
    else:
        first, second = (start_of(frame, v, kind, sensitivity, random) for v in views)
    return first, second


def _others(frame: Frame, pair: RectifiedPair) -> tuple[int, ...]:
    """Sources that can be the third view of a pair, the best one first."""
    rig = _rig(frame).subset(range(len(frame["depth"])))
    subject, up = look_at_point(rig), up_direction(rig)
    return candidates(
        rig,
        pair,
        [
            classify(rig, v, w, subject=subject, up=up)
            for v in range(len(rig))
            if v not in pair.views
            for w in pair.views
        ],
    )


def _further_at(
    frame: Frame, pair: RectifiedPair, point: np.ndarray, side: int, random: np.random.Generator
) -> Further | None:
    """The third view of a crop around a point [3], in the same size."""
    others = _others(frame, pair)
    if random.random() < WITHOUT_THIRD or not others:
        return None
    k = intrinsics_of(_rig(frame), pair, others[0])
    place = project(point[None], k, frame["world_to_camera"][others[0]])[0][0]
    x, y = np.round(place + random.uniform(-side / 8, side / 8, 2) - side / 2).astype(int)
    return Further(others[0], (int(x), int(y), side, side), random)


def _source(frame: Frame, view: int, start: Start) -> SourceView:
    return SourceView(frame["color"][view], frame["mask"][view], start.depth, start.confidence, None)


def _example(
    frame: Frame,
    sides: tuple[Side, Side],
    starts: tuple[Start, Start],
    target: Camera,
    between: int,
    marks: Marks,
    spoiling: Spoiling | None,
    further: Further | None,
) -> Example:
    sources = [_source(frame, s.view, start) for s, start in zip(sides, starts, strict=True)]
    first, second = sides
    if first.pair is second.pair:
        given = rectified_pair(first.pair, (sources[0], sources[1]), (first.window, second.window))
    else:
        given = PairViews.batch(
            [single_view(s.pair, v, (s.window, s.other)) for s, v in zip(sides, sources, strict=True)]
        )
    truth, pictures, cameras, maps = [], [], [], []
    for side, source in zip(sides, sources, strict=True):
        seen = np.where(foreground(source.mask), frame["truth"][side.view], 0)
        truth.append(start_on(side.pair, side.which, side.window, side.other, seen))
        x, y, _ = places(side.pair, side.which, side.window)
        pictures.append(cv2.remap(source.color, x, y, cv2.INTER_LINEAR).astype(np.float32) / 255)
        k = side.pair.intrinsics[side.which].copy()
        k[:2, 2] -= side.window[:2]
        cameras.append(Camera(k, side.pair.world_to_camera(side.which), *side.window[2:]))
        joints = found(frame["joints"][:, side.view], marks, None if spoiling is None else spoiling.random)
        joints[..., :2] = side.pair.rectified_pixels(side.which, joints[..., :2])[0] - np.array(side.window[:2])
        maps.append(heatmaps_of(joints, side.window[2:], marks))
    tint = torch.from_numpy((np.ones(3) if spoiling is None else spoiling.gain).astype(np.float32))
    color, cover = given.color * tint[:, None, None], given.cover
    if spoiling is not None:
        color, cover = spoilt(color, cover, spoiling.random)
        color = torch.stack([color[0], shifted(color[1], spoiling.misplaced)]) if spoiling.misplaced else color
    heatmaps, stabilised = (torch.from_numpy(np.stack(m)) for m in zip(*maps, strict=True))
    third = None if further is None else _third(frame, sides, further, marks, tint, spoiling)
    return Example(
        replace(given, color=color.clamp(0, 1), cover=cover, heatmaps=heatmaps, stabilised=stabilised, third=third),
        torch.from_numpy(np.stack(truth)[:, None]),
        (cameras[0], cameras[1]),
        (torch.from_numpy(np.stack(pictures)) * tint).clamp(max=1),
        target,
        (_cut(frame["color"][between], frame, between, target) * tint[:, None, None])[None].clamp(max=1),
        _cut(frame["mask"][between][..., None], frame, between, target)[None],
        False,
    )


def unfitting(example: Example, rows: float) -> Example:
    """The same pair, but its second picture [3, H, W] is moved across its rows by so many px, and a third one as far
    the other way: nothing fits any more."""
    (first, second), third = example.views.color, example.views.third
    third = None if third is None else replace(third, color=shifted(third.color[0], -rows)[None])
    return replace(
        example,
        views=replace(example.views, color=torch.stack([first, shifted(second, rows)]), third=third),
        strange=True,
    )


def _third(
    frame: Frame,
    sides: tuple[Side, Side],
    further: Further,
    marks: Marks,
    tint: torch.Tensor,
    spoiling: Spoiling | None,
) -> Third:
    """The third view of an example, spoilt on its own; where both views do not fit each other it fits neither."""
    rig, (view, window, random) = _rig(frame), further
    pair, around = sides[0].pair, (sides[0].window, sides[1].window)
    start = Start(frame["depth"][view], frame["confidence"][view].astype(np.float32))
    third = third_view(rig, pair, around, view, _source(frame, view, start), window, frame["joints"].shape[2])
    joints = found(frame["joints"][:, view], marks, random)
    joints[..., :2] = finer(rig, pair, view) * joints[..., :2] - np.array(window[:2])
    color = third.color[0] * tint[:, None, None]
    if random is not None and spoiling is not None:
        color = spoilt_third(color, random)
        color = shifted(color, -spoiling.misplaced) if spoiling.misplaced else color
    heatmaps = torch.from_numpy(heatmaps_of(joints, window[2:], marks)[0])[None]
    return replace(third, color=color.clamp(0, 1)[None], heatmaps=heatmaps)


def _rig(frame: Frame) -> Rig:
    height, width = frame["mask"].shape[1:]
    n = len(frame["intrinsics"])
    return Rig(
        tuple(f"{v:03d}" for v in range(n)),
        frame["intrinsics"],
        np.zeros((n, 8)),
        frame["world_to_camera"],
        np.tile([width, height], (n, 1)).astype(np.int64),
    )


def _centre(frame: Frame) -> np.ndarray:
    return look_at_point(_rig(frame).subset(range(len(frame["depth"]))))


def _point(truth: np.ndarray, depth: np.ndarray, sensitivity: float, random: np.random.Generator) -> tuple[int, int]:
    """Row and column of a pixel of the body; a share of them where the start is wrong."""
    inside = truth > 0
    if random.random() < HARD:
        with np.errstate(divide="ignore", invalid="ignore"):
            wrong = inside & (depth > 0) & (sensitivity * np.abs(1 / depth - 1 / truth) > 1)
        inside = wrong if wrong.any() else inside
    rows, columns = np.nonzero(inside)
    k = int(random.integers(len(rows)))
    return int(rows[k]), int(columns[k])


def _world(frame: Frame, view: int, row: int, column: int) -> np.ndarray:
    """[3] of a pixel's true surface, metres."""
    z = float(frame["truth"][view, row, column])
    centre = np.array([column, row]) + pixel_centres((1, 1))[0, 0]
    ray = np.linalg.inv(frame["intrinsics"][view]) @ np.array([*centre, 1.0])
    pose = frame["world_to_camera"][view]
    return pose[:3, :3].T @ (z * ray - pose[:3, 3])


def _target(frame: Frame, view: int, point: np.ndarray | None, side: int) -> Camera:
    """A held-out camera: a window of `side` px around a point, or the whole picture."""
    intrinsics, pose = frame["intrinsics"][view].copy(), frame["world_to_camera"][view]
    height, width = frame["mask"].shape[1:]
    if point is None:
        return Camera(intrinsics, pose, width, height)
    place = project(point[None], intrinsics, pose)[0][0]
    corner = np.clip(np.round(place - side / 2), 0, [width - side, height - side])
    intrinsics[:2, 2] -= corner
    return Camera(intrinsics, pose, side, side)


def _cut(picture: np.ndarray, frame: Frame, view: int, camera: Camera) -> torch.Tensor:
    """[C, h, w] 0..1 of a picture [H, W, C] uint8 of a view, as a camera that is its window sees it."""
    x, y = np.round(frame["intrinsics"][view][:2, 2] - np.asarray(camera.intrinsics)[:2, 2]).astype(int)
    part = picture[y : y + camera.height, x : x + camera.width].astype(np.float32) / 255
    return torch.from_numpy(part).permute(2, 0, 1)
