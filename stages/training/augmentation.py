"""What is done to the pictures of a step, as real cameras and mattings would do it."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import torch

SPOILT = 0.3
"""Share of the crops that each of these is done to, as real cameras do it:"""
UNLIKE, DARKER = 0.06, 1.4
"""largest change of a colour channel's gain, another one in each view, and of the exposure of both together, stops; a
quarter of that of each;"""
GRAIN, BLUR = 0.04, 1.5
"""largest standard deviation of noise, of brightness 0..1, and of a blur of both views, px;"""
SLIP = 0.75
"""largest shift of the second view across its rows, px, as a calibration that is off has it;"""
QUALITY = (30, 90)
"""worst and best quality of compression as JPEG, as libjpeg counts it;"""
SOFT, RAGGED = 2.0, 0.35
"""largest softness of an outline, px, and how far its level is from a half, so that it lies inside or outside."""
FARTHEST = 0.4
"""Of the crop's side, the largest shift of pictures that do not fit; the least is `STRANGE_LEAST` px."""
STRANGE_LEAST = 8


def spoilt(color: torch.Tensor, cover: torch.Tensor, random: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Premultiplied colours [2, 3, H, W] and covers [2, 1, H, W] of both views as real cameras and mattings might give
    them."""
    ragged = random.random() < SPOILT
    if ragged:
        color, cover = outlined(color, cover, random)
    unlike, darker, grainy, blurred, slipped, packed = (random.random(6) < SPOILT).tolist()
    if unlike:
        color = color * torch.from_numpy(1 + random.uniform(-UNLIKE, UNLIKE, (2, 3, 1, 1)).astype(np.float32))
    if darker:
        stops = random.uniform(-DARKER, DARKER) + random.uniform(-DARKER / 4, DARKER / 4, (2, 1, 1, 1))
        color = color * torch.from_numpy(np.float32(2.0) ** stops.astype(np.float32))
    if blurred:
        sigma = float(random.uniform(0.3, BLUR))
        color = torch.stack([blurred_by(c, sigma) for c in color])
    if slipped:
        color = torch.stack([color[0], shifted(color[1], float(random.uniform(-SLIP, SLIP)))])
    if grainy:
        color = color + cover * torch.from_numpy(
            random.normal(0, random.uniform(0, GRAIN), color.shape).astype(np.float32)
        )
    if packed:
        quality = int(random.integers(*QUALITY))
        color = torch.stack([compressed(c, quality) for c in color]) * (cover > 0)
    return color, cover


def misplacement(side: int, random: np.random.Generator) -> float:
    """Rows by which the second view of a crop of `side` px is shifted so that nothing in it fits."""
    shift = float(random.uniform(STRANGE_LEAST, max(STRANGE_LEAST, FARTHEST * side)))
    return shift if random.random() < 0.5 else -shift


def spoilt_third(color: torch.Tensor, random: np.random.Generator) -> torch.Tensor:
    """Premultiplied colours [3, H, W] of a third view, spoilt on its own."""
    lit = (color > 0).any(0)
    unlike, grainy, blurred, slipped = (random.random(4) < SPOILT).tolist()
    if unlike:
        color = color * torch.from_numpy(1 + random.uniform(-UNLIKE, UNLIKE, (3, 1, 1)).astype(np.float32))
    if blurred:
        color = blurred_by(color, float(random.uniform(0.3, BLUR)))
    if slipped:
        color = shifted(color, float(random.uniform(-SLIP, SLIP)))
    if grainy:
        color = color + lit * torch.from_numpy(
            random.normal(0, random.uniform(0, GRAIN), tuple(color.shape)).astype(np.float32)
        )
    return color


def outlined(
    color: torch.Tensor, cover: torch.Tensor, random: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """Both with an outline that is soft and lies a little inside or outside, before a background of one colour."""
    behind = torch.from_numpy(random.uniform(0, 0.7, (1, 3, 1, 1)).astype(np.float32))
    full = color + (1 - cover) * behind
    sigma, level = float(random.uniform(0.5, SOFT)), 0.5 + float(random.uniform(-RAGGED, RAGGED))
    soft = torch.stack([blurred_by(c.expand(3, -1, -1), sigma)[:1] for c in cover])
    moved = ((soft - level) * (1 + sigma) + 0.5).clamp(0, 1)
    return full * moved, moved


def blurred_by(color: torch.Tensor, sigma: float) -> torch.Tensor:
    """A picture [3, H, W] blurred by so many px."""
    return _changed(color, lambda picture: cv2.GaussianBlur(picture, (0, 0), sigma))


def shifted(color: torch.Tensor, rows: float) -> torch.Tensor:
    """A picture [3, H, W] moved down by so many rows; black comes in."""
    height, width = color.shape[1:]
    by = np.array([[1.0, 0, 0], [0, 1, rows]])
    return _changed(color, lambda picture: cv2.warpAffine(picture, by, (width, height), flags=cv2.INTER_LINEAR))


def compressed(color: torch.Tensor, quality: int) -> torch.Tensor:
    """A picture [3, H, W], 0..1, after it was stored as JPEG."""

    def stored(picture: np.ndarray) -> np.ndarray:
        bytes_ = np.rint(255 * np.clip(picture[..., ::-1], 0, 1)).astype(np.uint8)
        read = cv2.imdecode(cv2.imencode(".jpg", bytes_, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
        assert read is not None, "OpenCV reads what it wrote"
        return read[..., ::-1].astype(np.float32) / 255

    return _changed(color, stored)


def _changed(color: torch.Tensor, change: Callable[[np.ndarray], np.ndarray]) -> torch.Tensor:
    """A picture [3, H, W] that OpenCV changed as [H, W, 3]."""
    picture = change(np.ascontiguousarray(np.moveaxis(color.numpy(), 0, -1)))
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(picture, -1, 0)))
