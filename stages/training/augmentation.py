"""What is done to the pictures of a step, as real cameras would do it."""

from __future__ import annotations

import cv2
import numpy as np
import torch

SPOILT = 0.3
"""Share of the crops that each of these is done to, as real cameras do it:"""
UNLIKE = 0.06
"""largest change of a colour channel's gain, another one in each view;"""
GRAIN, BLUR = 0.03, 1.2
"""largest standard deviation of noise, of brightness 0..1, and of a blur of both views, px;"""
SLIP = 0.75
"""largest shift of the second view across its rows, px, as a calibration that is off has it."""
STRANGE = 0.15
"""Share of the crops whose second view is shifted by so much that nothing in it fits: the start must stand there,
with no confidence."""
FARTHEST = 0.4
"""Of the crop's side, the largest of these shifts; the least is `STRANGE_LEAST` px."""
STRANGE_LEAST = 8


def spoilt(color: torch.Tensor, cover: torch.Tensor, random: np.random.Generator) -> tuple[torch.Tensor, float]:
    """Premultiplied colours [2, 3, H, W] of both views as real cameras might give them, and the shift, px, by which
    they do not fit each other (0: they do)."""
    unlike, grainy, blurred, slipped = (random.random(4) < SPOILT).tolist()
    if unlike:
        color = color * torch.from_numpy(1 + random.uniform(-UNLIKE, UNLIKE, (2, 3, 1, 1)).astype(np.float32))
    if blurred:
        sigma = float(random.uniform(0.3, BLUR))
        color = torch.stack([blurred_by(c, sigma) for c in color])
    if slipped:
        color = torch.stack([color[0], shifted(color[1], float(random.uniform(-SLIP, SLIP)))])
    strange = 0.0
    if random.random() < STRANGE:
        shift = float(random.uniform(STRANGE_LEAST, max(STRANGE_LEAST, FARTHEST * color.shape[2])))
        strange = shift if random.random() < 0.5 else -shift
        color = torch.stack([color[0], shifted(color[1], strange)])
    if grainy:
        color = color + cover * torch.from_numpy(
            random.normal(0, random.uniform(0, GRAIN), color.shape).astype(np.float32)
        )
    return color, strange


def spoilt_third(color: torch.Tensor, strange: float, random: np.random.Generator) -> torch.Tensor:
    """Premultiplied colours [3, H, W] of a third view, spoilt on its own; where both views are apart by `strange`
    px, it fits neither."""
    lit = (color > 0).any(0)
    unlike, grainy, blurred, slipped = (random.random(4) < SPOILT).tolist()
    if unlike:
        color = color * torch.from_numpy(1 + random.uniform(-UNLIKE, UNLIKE, (3, 1, 1)).astype(np.float32))
    if blurred:
        color = blurred_by(color, float(random.uniform(0.3, BLUR)))
    if slipped:
        color = shifted(color, float(random.uniform(-SLIP, SLIP)))
    if strange:
        color = shifted(color, -strange)
    if grainy:
        color = color + lit * torch.from_numpy(
            random.normal(0, random.uniform(0, GRAIN), tuple(color.shape)).astype(np.float32)
        )
    return color


def blurred_by(color: torch.Tensor, sigma: float) -> torch.Tensor:
    """A picture [3, H, W] blurred by so many px."""
    return torch.from_numpy(
        np.ascontiguousarray(np.moveaxis(cv2.GaussianBlur(np.moveaxis(color.numpy(), 0, -1), (0, 0), sigma), -1, 0))
    )


def shifted(color: torch.Tensor, rows: float) -> torch.Tensor:
    """A picture [3, H, W] moved down by so many rows; black comes in."""
    height, width = color.shape[1:]
    moved = cv2.warpAffine(
        np.ascontiguousarray(np.moveaxis(color.numpy(), 0, -1)),
        np.array([[1.0, 0, 0], [0, 1, rows]]),
        (width, height),
        flags=cv2.INTER_LINEAR,
    )
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(moved, -1, 0)))
