"""What a step is given: crops of pairs of views around the same point of the body,
the truth, and a picture from between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
import torch

from posegaussian.stages.geometry.pairs import classify
from posegaussian.stages.geometry.projection import pixel_centres, project
from posegaussian.stages.geometry.rectification import RectifiedPair, Window, rectify
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.stages.network.model.encoders import HEATMAP_CELL
from posegaussian.stages.network.model.pairs import (
    PairViews,
    SourceView,
    Third,
    places,
    rectified_pair,
    start_on,
    windows,
)
from posegaussian.stages.network.third_view import candidates, finer, intrinsics_of, third_view, window_around
from posegaussian.stages.pose.heatmaps import draw
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.stages.training.augmentation import shifted, spoilt, spoilt_third
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import foreground

HARD = 0.4
"""Share of the crops that lie around a pixel whose start is more than a px off."""
WITHOUT_JOINTS = 0.1
"""Share of the crops without any joints, as captures without an estimator have it."""
JOINT_NOISE = 3.0
"""Px, largest standard deviation of what joints are moved by."""
SIGMAS = (5.0, 10.0)
"""Px, narrowest and broadest heatmap of a joint.
The pose stage's 4 cm are about 10 px at the size of a person in these pictures."""
TINT = 0.08
"""Largest change of a colour channel's gain, the same in both views and the target."""
WITHOUT_THIRD = 0.2
"""Share of the crops without a third view, where a network of such is trained: pairs of small rigs have none."""
Frame = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Example:
    """One pair of views."""

    views: PairViews
    """Both directions."""
    truth: torch.Tensor
    """[2, 1, H, W] true disparity, px, NaN where there is none."""
    pair: RectifiedPair
    windows: tuple[Window, Window]
    """Of the rectified frame."""
    picture: torch.Tensor
    """[2, H, W, 3] the rectified pictures as the Gaussians take them, sRGB 0..1."""
    target: Camera
    """A held-out camera between both views, cropped."""
    seen: torch.Tensor
    """[1, 3, h, w] what it sees, premultiplied."""
    cover: torch.Tensor
    """[1, 1, h, w] its mask, 0..1."""
    strange: bool
    """Whether the two pictures do not fit each other, so that nothing can be learnt from one about the other."""


class Further(NamedTuple):
    """The third view of an example."""

    view: int
    """Of the frame."""
    window: Window
    """In pixels as fine as the pair's."""
    random: np.random.Generator | None
    """Of what is done to it alone; None: nothing is."""


class Marks(NamedTuple):
    """How an example's joints are drawn."""

    none: bool
    """Whether there are none."""
    noise: float
    """Px, standard deviation of what they are moved by."""
    sigma: float
    """Px."""


def frames_of_step(config: TrainingConfig, step: int) -> range:
    """Training frames at hand for a step, counted from 0:
    a window that moves on by a frame every `steps_per_frame` steps."""
    first = step // config.steps_per_frame
    return range(first, first + config.window)


def drawn(config: TrainingConfig, step: int, frames: Mapping[int, Frame]) -> tuple[list[Example], int]:
    """The examples of a step and its number of iterations: they follow from (config.seed, step) alone."""
    random = np.random.default_rng([config.seed, step])
    at_hand = frames_of_step(config, step)
    found = [
        crop(frames[at_hand[int(random.integers(len(at_hand)))]], config.crop, random, config.further_views)
        for _ in range(config.batch)
    ]
    return found, int(random.integers(1, config.iterations + 1))


def crop(frame: Frame, side: int, random: np.random.Generator, further_views: bool = False) -> Example:
    """A pair of a frame, cut out around a point that the first view sees, and a third view cut out around the same
    where it is asked for.

    What concerns the third view alone is drawn from a generator of its own: all else is the same with it and without.
    """
    a, b, between = (int(v) for v in frame["pairs"][random.integers(len(frame["pairs"]))])
    if random.random() < 0.5:
        a, b = b, a
    pair = rectify(_rig(frame), a, b, _centre(frame))
    row, column = _point(frame, a, pair, random)
    point = _world(frame, a, row, column)
    centres = [project(point[None], pair.intrinsics[w], pair.world_to_camera(w))[0][0] for w in (0, 1)]
    off = random.uniform(-side / 8, side / 8, 2)
    corners = [np.round(p + off - side / 2).astype(int) for p in centres]
    found = tuple((int(c[0]), int(corners[0][1]), side, side) for c in corners)
    gain = 1 + random.uniform(-TINT, TINT, 3)
    further = _further_at(frame, pair, point, side, random.spawn(1)[0]) if further_views else None
    return _example(frame, (a, b, between), pair, (found[0], found[1]), point, side // 2, random, gain, further)


def whole(frame: Frame, row: int, multiple: int, further_views: bool = False) -> Example:
    """A pair of a frame without a crop, as inference sees it."""
    a, b, between = (int(v) for v in frame["pairs"][row])
    pair = rectify(_rig(frame), a, b, _centre(frame))
    found = windows(pair, (frame["depth"][a] > 0, frame["depth"][b] > 0), multiple)
    assert found is not None, "a training frame without a subject"
    further = None
    for view in _others(frame, pair) if further_views else ():
        window = window_around(frame["depth"][view] > 0, finer(_rig(frame), pair, view), multiple)
        if window is not None:
            further = Further(view, window, None)
            break
    return _example(frame, (a, b, between), pair, found, None, 0, None, np.ones(3), further)


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
    found = _others(frame, pair)
    if random.random() < WITHOUT_THIRD or not found:
        return None
    place = project(point[None], intrinsics_of(_rig(frame), pair, found[0]), frame["world_to_camera"][found[0]])[0][0]
    x, y = np.round(place + random.uniform(-side / 8, side / 8, 2) - side / 2).astype(int)
    return Further(found[0], (int(x), int(y), side, side), random)


def _source(frame: Frame, view: int) -> SourceView:
    return SourceView(frame["color"][view], frame["mask"][view], frame["depth"][view], frame["confidence"][view], None)


def _example(
    frame: Frame,
    views: tuple[int, int, int],
    pair: RectifiedPair,
    found: tuple[Window, Window],
    point: np.ndarray | None,
    side: int,
    random: np.random.Generator | None,
    gain: np.ndarray,
    further: Further | None,
) -> Example:
    a, b, between = views
    shown = tuple(_source(frame, v) for v in (a, b))
    given = rectified_pair(pair, (shown[0], shown[1]), found)
    tint = torch.from_numpy(gain.astype(np.float32))
    truth = [
        start_on(pair, w, found[w], found[1 - w], np.where(foreground(frame["mask"][v]), frame["truth"][v], 0))
        for w, v in enumerate((a, b))
    ]
    pictures = [
        cv2.remap(shown[w].color, *places(pair, w, found[w])[:2], cv2.INTER_LINEAR).astype(np.float32) / 255
        for w in (0, 1)
    ]
    camera = _target(frame, between, point, side)
    seen = _cut(frame["color"][between], frame, between, camera).astype(np.float32) / 255
    cover = _cut(frame["mask"][between], frame, between, camera).astype(np.float32) / 255
    marks = _marks(random)
    heatmaps, color, strange = _heatmaps(frame, pair, found, marks, random), given.color * tint[:, None, None], 0.0
    if random is not None:
        color, strange = spoilt(color, given.cover, random)
    third = None if further is None else _third(frame, pair, found, further, marks, tint, strange)
    return Example(
        replace(given, heatmaps=heatmaps, color=color.clamp(0, 1), third=third),
        torch.from_numpy(np.stack(truth)[:, None]),
        pair,
        found,
        (torch.from_numpy(np.stack(pictures)) * tint).clamp(max=1),
        camera,
        (torch.from_numpy(seen).permute(2, 0, 1)[None] * tint[:, None, None]).clamp(max=1),
        torch.from_numpy(cover)[None, None],
        strange != 0,
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
    pair: RectifiedPair,
    found: tuple[Window, Window],
    further: Further,
    marks: Marks,
    tint: torch.Tensor,
    strange: float,
) -> Third:
    """The third view of an example, spoilt on its own; where both views do not fit each other it fits neither."""
    rig, (view, window, random) = _rig(frame), further
    third = third_view(rig, pair, found, view, _source(frame, view), window, frame["joints"].shape[1])
    joints = _moved(frame["joints"][view], marks, random)
    joints[:, :2] = finer(rig, pair, view) * joints[:, :2] - np.array(window[:2])
    color = third.color[0] * tint[:, None, None]
    if random is not None:
        color = spoilt_third(color, strange, random)
    return replace(third, color=color.clamp(0, 1)[None], heatmaps=torch.from_numpy(_drawn(joints, window, marks))[None])


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


def _point(frame: Frame, view: int, pair: RectifiedPair, random: np.random.Generator) -> tuple[int, int]:
    """Row and column of a pixel of the body; a share of them where the start is wrong."""
    truth, depth = frame["truth"][view], frame["depth"][view]
    inside = truth > 0
    if random.random() < HARD:
        with np.errstate(divide="ignore", invalid="ignore"):
            wrong = inside & (depth > 0) & (pair.sensitivity * np.abs(1 / depth - 1 / truth) > 1)
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


def _marks(random: np.random.Generator | None) -> Marks:
    if random is None:
        return Marks(False, 0.0, SIGMAS[1])
    none = bool(random.random() < WITHOUT_JOINTS)
    return Marks(none, float(random.uniform(0, JOINT_NOISE)), float(random.uniform(*SIGMAS)))


def _heatmaps(
    frame: Frame, pair: RectifiedPair, found: tuple[Window, Window], marks: Marks, random: np.random.Generator | None
) -> torch.Tensor:
    """[2, 17, H / 4, W / 4] drawn on the windows."""
    maps = []
    for which, view in enumerate(pair.views):
        joints = _moved(frame["joints"][view], marks, random)
        joints[:, :2] = pair.rectified_pixels(which, joints[:, :2])[0] - np.array(found[which][:2])
        maps.append(_drawn(joints, found[which], marks))
    return torch.from_numpy(np.stack(maps))


def _moved(joints: np.ndarray, marks: Marks, random: np.random.Generator | None) -> np.ndarray:
    """Joints [J, (u, v, score)] of a view, moved as an estimator would; with scores of 0 where there are none."""
    joints = joints.copy()
    if random is not None:
        joints[:, :2] += random.normal(0, marks.noise, (len(joints), 2))
    joints[:, 2] *= not marks.none
    return joints


def _drawn(joints: np.ndarray, window: Window, marks: Marks) -> np.ndarray:
    """[J, H / 4, W / 4] float32 of joints in pixels of a window."""
    width, height = window[2:]
    return draw(
        joints[None],
        np.full((1, len(joints)), marks.sigma),
        (width, height),
        (height // HEATMAP_CELL, width // HEATMAP_CELL),
    )[0].astype(np.float32)


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


def _cut(picture: np.ndarray, frame: Frame, view: int, camera: Camera) -> np.ndarray:
    x, y = np.round(frame["intrinsics"][view][:2, 2] - np.asarray(camera.intrinsics)[:2, 2]).astype(int)
    return picture[y : y + camera.height, x : x + camera.width]
