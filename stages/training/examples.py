"""What a step is given: crops of pairs of views around the same point of the body, the truth, and a picture from between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from stages.geometry.projection import pixel_centres, project
from stages.geometry.rectification import RectifiedPair, Window, rectify
from stages.geometry.subject import look_at_point
from stages.network.encoders import HEATMAP_CELL
from stages.network.views import SourceView, Views, places, rectified_pair, start_on, windows
from stages.pose.heatmaps import draw
from stages.rendering.scene import Camera
from stages.training.config import TrainingConfig
from storage.rig import Rig

HARD = 0.4
"""Share of the crops that lie around a pixel whose start is more than a px off."""
WITHOUT_JOINTS = 0.1
"""Share of the crops without any joints, as captures without an estimator have it."""
JOINT_NOISE = 3.0
"""Px, largest standard deviation of what joints are moved by."""
SIGMAS = (5.0, 10.0)
"""Px, narrowest and broadest heatmap of a joint. The pose stage's 4 cm are about 10 px at the size of a person in these pictures."""
TINT = 0.08
"""Largest change of a colour channel's gain, the same in both views and the target."""
SPOILT = 0.3
"""Share of the crops that each of these is done to, as real cameras do it:"""
UNLIKE = 0.06
"""largest change of a colour channel's gain, another one in each view;"""
GRAIN, BLUR = 0.03, 1.2
"""largest standard deviation of noise, of brightness 0..1, and of a blur of both views, px;"""
SLIP = 0.75
"""largest shift of the second view across its rows, px, as a calibration that is off has it."""
STRANGE = 0.15
"""Share of the crops whose second view is shifted by so much that nothing in it fits: the start must stand there, with no confidence."""
FARTHEST = 0.4
"""Of the crop's side, the largest of these shifts; the least is `STRANGE_LEAST` px."""
STRANGE_LEAST = 8
Frame = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Example:
    """One pair of views."""

    views: Views
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


def frames_of_step(config: TrainingConfig, step: int) -> range:
    """Training frames at hand for a step, counted from 0: a window that moves on by a frame every `steps_per_frame` steps."""
    first = step // config.steps_per_frame
    return range(first, first + config.window)


def drawn(config: TrainingConfig, step: int, frames: Mapping[int, Frame]) -> tuple[list[Example], int]:
    """The examples of a step and its number of iterations: they follow from (config.seed, step) alone."""
    random = np.random.default_rng([config.seed, step])
    at_hand = frames_of_step(config, step)
    found = [crop(frames[at_hand[int(random.integers(len(at_hand)))]], config.crop, random) for _ in range(config.batch)]
    return found, int(random.integers(1, config.iterations + 1))


def crop(frame: Frame, side: int, random: np.random.Generator) -> Example:
    """A pair of a frame, cut out around a point that the first view sees."""
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
    return _example(frame, (a, b, between), pair, (found[0], found[1]), point, side // 2, random, gain)


def whole(frame: Frame, row: int, multiple: int) -> Example:
    """A pair of a frame without a crop, as inference sees it."""
    a, b, between = (int(v) for v in frame["pairs"][row])
    pair = rectify(_rig(frame), a, b, _centre(frame))
    found = windows(pair, (frame["depth"][a] > 0, frame["depth"][b] > 0), multiple)
    assert found is not None, "a training frame without a subject"
    return _example(frame, (a, b, between), pair, found, None, 0, None, np.ones(3))


def _example(frame: Frame, views: tuple[int, int, int], pair: RectifiedPair, found: tuple[Window, Window], point: np.ndarray | None, side: int, random: np.random.Generator | None, gain: np.ndarray) -> Example:
    a, b, between = views
    shown = tuple(SourceView(frame["color"][v], frame["mask"][v], frame["depth"][v], frame["confidence"][v], None) for v in (a, b))
    given = rectified_pair(pair, (shown[0], shown[1]), found)
    tint = torch.from_numpy(gain.astype(np.float32))
    truth = [start_on(pair, w, found[w], found[1 - w], np.where(frame["mask"][v] > 127, frame["truth"][v], 0)) for w, v in enumerate((a, b))]
    pictures = [cv2.remap(shown[w].color, *places(pair, w, found[w])[:2], cv2.INTER_LINEAR).astype(np.float32) / 255 for w in (0, 1)]
    camera = _target(frame, between, point, side)
    seen = _cut(frame["color"][between], frame, between, camera).astype(np.float32) / 255
    cover = _cut(frame["mask"][between], frame, between, camera).astype(np.float32) / 255
    heatmaps, color, strange = _heatmaps(frame, pair, found, random), given.color * tint[:, None, None], False
    if random is not None:
        color, strange = _spoilt(color, given.cover, random)
    return Example(
        replace(given, heatmaps=heatmaps, color=color.clamp(0, 1)), torch.from_numpy(np.stack(truth)[:, None]), pair, found,
        (torch.from_numpy(np.stack(pictures)) * tint).clamp(max=1), camera,
        (torch.from_numpy(seen).permute(2, 0, 1)[None] * tint[:, None, None]).clamp(max=1), torch.from_numpy(cover)[None, None], strange,
    )  # fmt: skip


def unfitting(example: Example, rows: float) -> Example:
    """The same pair, but its second picture [3, H, W] is moved across its rows by so many px: nothing in it fits the first any more."""
    first, second = example.views.color
    return replace(example, views=replace(example.views, color=torch.stack([first, _shifted(second, rows)])), strange=True)


def _spoilt(color: torch.Tensor, cover: torch.Tensor, random: np.random.Generator) -> tuple[torch.Tensor, bool]:
    """Premultiplied colours [2, 3, H, W] of both views as real cameras might give them, and whether they no longer fit each other."""
    unlike, grainy, blurred, slipped = (random.random(4) < SPOILT).tolist()
    if unlike:
        color = color * torch.from_numpy(1 + random.uniform(-UNLIKE, UNLIKE, (2, 3, 1, 1)).astype(np.float32))
    if blurred:
        sigma = float(random.uniform(0.3, BLUR))
        color = torch.from_numpy(np.stack([np.moveaxis(cv2.GaussianBlur(np.moveaxis(c.numpy(), 0, -1), (0, 0), sigma), -1, 0) for c in color]))
    if slipped:
        color = torch.stack([color[0], _shifted(color[1], float(random.uniform(-SLIP, SLIP)))])
    strange = bool(random.random() < STRANGE)
    if strange:
        shift = float(random.uniform(STRANGE_LEAST, max(STRANGE_LEAST, FARTHEST * color.shape[2])))
        color = torch.stack([color[0], _shifted(color[1], shift if random.random() < 0.5 else -shift)])
    if grainy:
        color = color + cover * torch.from_numpy(random.normal(0, random.uniform(0, GRAIN), color.shape).astype(np.float32))
    return color, strange


def _shifted(color: torch.Tensor, rows: float) -> torch.Tensor:
    """A picture [3, H, W] moved down by so many rows; black comes in."""
    height, width = color.shape[1:]
    moved = cv2.warpAffine(np.ascontiguousarray(np.moveaxis(color.numpy(), 0, -1)), np.array([[1.0, 0, 0], [0, 1, rows]]), (width, height), flags=cv2.INTER_LINEAR)
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(moved, -1, 0)))


def _rig(frame: Frame) -> Rig:
    height, width = frame["mask"].shape[1:]
    n = len(frame["intrinsics"])
    return Rig(tuple(f"{v:03d}" for v in range(n)), frame["intrinsics"], np.zeros((n, 8)), frame["world_to_camera"], np.tile([width, height], (n, 1)).astype(np.int64))


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


def _heatmaps(frame: Frame, pair: RectifiedPair, found: tuple[Window, Window], random: np.random.Generator | None) -> torch.Tensor:
    """[2, 17, H / 4, W / 4] drawn on the windows, with joints moved as an estimator would; now and then none."""
    width, height = found[0][2:]
    none = random is not None and random.random() < WITHOUT_JOINTS
    noise = 0.0 if random is None else float(random.uniform(0, JOINT_NOISE))
    sigma = SIGMAS[1] if random is None else float(random.uniform(*SIGMAS))
    drawn_maps = []
    for which, view in enumerate(pair.views):
        joints = frame["joints"][view].copy()
        if random is not None:
            joints[:, :2] += random.normal(0, noise, (len(joints), 2))
        joints[:, :2] = pair.rectified_pixels(which, joints[:, :2])[0] - np.array(found[which][:2])
        joints[:, 2] *= not none
        drawn_maps.append(draw(joints[None], np.full((1, len(joints)), sigma), (width, height), (height // HEATMAP_CELL, width // HEATMAP_CELL))[0])
    return torch.from_numpy(np.stack(drawn_maps).astype(np.float32))


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
