"""The heads: what the network would change of the analytic prior, pixel by pixel. What they say is float32 (float64
stays).

Every head predicts a residual: outputs of 0 give the prior itself, and the last convolutions begin at 0. Numbers are
kept in range by `limited`, whose slope falls like 1/x^2 and never to 0, so that no pixel is ever lost to training.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import torch
from torch import nn

from posegaussian.stages.geometry.tangent_frame import tangents
from posegaussian.stages.network.model.correlation import exact
from posegaussian.stages.network.model.layout import shuffled
from posegaussian.stages.network.model.update import pointwise

RotationKind = Literal["normal", "quaternion"]
LIMIT = 6.0
"""Bound of every head's number: scales change by 1/280 to 8.7, confidence and shares stay in 0.0025..0.9975."""
CONFIDENCE_BIAS = LIMIT / (LIMIT - 1)
"""Gives a logit of exactly +1 after `limited`: a confidence and shares of 0.73 at the start of training."""
FACING = 0.05
"""Least cosine between a learned normal and the ray to the camera."""


class Prior(NamedTuple):
    """The analytic prior of a batch of pictures, as the gaussians stage makes it;
    0 in every map where there is no surface."""

    disparity: torch.Tensor
    """[B, 1, h, w] px of the rectified pair."""
    scale: torch.Tensor
    """[B, 3, h, w] m along (tangent, tangent, normal)."""
    normal: torch.Tensor
    """[B, 3, h, w] unit, camera axes, facing the camera."""
    opacity: torch.Tensor
    """[B, 2, h, w] face-on and grazing, 0..1."""

    @property
    def surface(self) -> torch.Tensor:
        """[B, 1, h, w] bool."""
        return self.opacity[:, :1] > 0


class HeadMaps(NamedTuple):
    """Learned or blended maps; 0 where the prior has no surface."""

    disparity: torch.Tensor
    """[B, 1, h, w] px."""
    scale: torch.Tensor
    """[B, 3, h, w] m."""
    rotation: torch.Tensor
    """[B, 3, h, w] unit normal, or [B, 4, h, w] unit quaternion (w, x, y, z) of the Gaussian's axes in camera axes."""
    opacity: torch.Tensor
    """[B, 2, h, w] face-on and grazing."""
    shares: torch.Tensor
    """[B, 2, h, w] of the learned value: of disparity, and of scale, rotation and opacity."""


def limited(x: torch.Tensor, limit: float = LIMIT) -> torch.Tensor:
    """Bounded: limit x / (limit + |x|): slope 1 at 0, within (-limit, limit),
    slope (limit / (limit + |x|))^2 everywhere."""
    return limit * x / (limit + x.abs())


def growth(x: torch.Tensor) -> torch.Tensor:
    """softplus(limited(x)) / softplus(0): positive, 1 at 0."""
    return nn.functional.softplus(limited(x)) / math.log(2)


def unit(v: torch.Tensor, otherwise: torch.Tensor) -> torch.Tensor:
    """Divide v [B, C, h, w] by its length; where that is under 1e-6, `otherwise`, without a gradient to v."""
    usable = (v.detach() ** 2).sum(dim=1, keepdim=True) > 1e-12
    safe = torch.where(usable, v, torch.ones_like(v))
    return torch.where(usable, safe / torch.sqrt((safe * safe).sum(dim=1, keepdim=True)), otherwise)


def learned_scale(x: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
    """[B, 3, h, w] m: the prior's scale, a footprint, times `growth`."""
    return scale * growth(x)


def learned_opacity(x: torch.Tensor, opacity: torch.Tensor) -> torch.Tensor:
    """[B, 2, h, w] in 0..1: sigmoid(logit(prior) + limited(x)), 0 where the prior is.

    x of 2 channels changes the opacity face-on and at grazing angle each for itself; x of 1 channel makes an opacity
    that is the same from everywhere, a change of the prior's face-on value.
    """
    prior = opacity if x.shape[1] == 2 else opacity[:, :1].expand_as(opacity)
    odds = torch.logit(prior.clamp(1e-4, 1 - 1e-4))
    return torch.where(prior > 0, torch.sigmoid(odds + limited(x)), 0)


def seen_opacity(opacity: torch.Tensor, cosine: torch.Tensor) -> torch.Tensor:
    """[B, 1, h, w]: c face_on + (1 - c) grazing, c [B, 1, h, w] the cosine between normal and ray to the camera;
    0 from behind."""
    return torch.where(cosine > 0, cosine * opacity[:, :1] + (1 - cosine) * opacity[:, 1:2], 0)


def learned_normal(x: torch.Tensor, normal: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    """[B, 3, h, w] unit normals of x [B, 3, h, w]: (x0, x1, growth(x2)) in the prior's tangent frame.

    They lie within 90 degrees of the prior's, so that their blend never vanishes, and are turned to face the camera
    where the cosine to `rays` [B, 3, h, w], unit, from the camera, would be under `FACING`. 0 where the prior is 0.
    """
    ahead, there = _standing(normal)
    first, second = (torch.stack(t, dim=1) for t in tangents(*ahead.unbind(dim=1)))
    v = limited(x[:, :1]) * first + limited(x[:, 1:2]) * second + growth(x[:, 2:3]) * ahead
    v = unit(v, ahead)
    v = v - rays * torch.relu((v * rays).sum(dim=1, keepdim=True) + FACING)
    return torch.where(there, unit(v, ahead), 0)


def _standing(normal: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Normals with (0, 0, -1) where they are 0, and where they are not [B, 1, h, w]."""
    there = (normal != 0).any(dim=1, keepdim=True)
    facing = torch.zeros_like(normal)
    facing[:, 2] = -1
    return torch.where(there, normal, facing), there


def quaternion_of(normal: torch.Tensor) -> torch.Tensor:
    """[B, 4, h, w] unit (w, x, y, z) of the rotation whose columns are (tangents(normal), normal); 0 where the normal
    is.

    (-ny, 1 - nz, 0, nx) / sqrt(2 - 2 nz): the smallest rotation from (0, 0, -1) to n after half a turn about x.
    """
    ahead, there = _standing(normal)
    nx, ny, nz = ahead.unbind(dim=1)
    q = torch.stack([-ny, 1 - nz, torch.zeros_like(nx), nx], dim=1) / torch.sqrt(2 - 2 * nz)[:, None]
    return torch.where(there, q, 0)


def normal_of(rotation: torch.Tensor) -> torch.Tensor:
    """[B, 3, h, w] the Gaussian's third axis, camera axes: a normal as it is, or the last column of a quaternion's
    rotation (w, x, y, z)."""
    if rotation.shape[1] == 3:
        return rotation
    w, x, y, z = rotation.unbind(dim=1)
    return torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z], dim=1)


def twist_of(rotation: torch.Tensor) -> torch.Tensor:
    """[B, 2, h, w] cosine and sine of the turn about `normal_of` a unit quaternion [B, 4, h, w] that takes the tangents
    that follow from the normal to the Gaussian's first two axes; (1, 0) where there is no rotation.

    The first axis in the frame of the tangents, by products alone: nothing is lost at half a turn, as of an angle.
    """
    w, x, y, z = rotation.unbind(dim=1)
    first = (w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y))
    there = (rotation != 0).any(dim=1)
    frame = tangents(*_standing(normal_of(rotation))[0].unbind(dim=1))
    cosine, sine = (a[0] * first[0] + a[1] * first[1] + a[2] * first[2] for a in frame)
    return torch.stack([torch.where(there, cosine, 1), torch.where(there, sine, 0)], dim=1)


def learned_quaternion(x: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """[B, 4, h, w] unit: the prior's rotation times the one of (growth(x0), x1, x2, x3), which is under half a turn
    and never 0."""
    a, b, c, d = quaternion_of(normal).unbind(dim=1)
    step = torch.cat([growth(x[:, :1]), limited(x[:, 1:])], dim=1)
    w, i, j, k = (step / torch.sqrt((step * step).sum(dim=1, keepdim=True))).unbind(dim=1)
    return torch.stack(
        [
            a * w - b * i - c * j - d * k,
            a * i + b * w + c * k - d * j,
            a * j - b * k + c * w + d * i,
            a * k + b * j - c * i + d * w,
        ],
        dim=1,
    )


def blend_directions(prior: torch.Tensor, learned: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
    """[B, 3, h, w] the weighted sum of two unit normals, renormalised; the prior itself at a share of 0 and
    where they cancel, 0 where both are 0."""
    return torch.where(share > 0, unit((1 - share) * prior + share * learned, prior), prior)


def blend_quaternions(prior: torch.Tensor, learned: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
    """[B, 4, h, w] the same of unit quaternions, the learned one taken with the sign of the prior's hemisphere (q
    and -q are one rotation)."""
    product = (prior * learned).sum(dim=1, keepdim=True)
    return blend_directions(prior, torch.where(product < 0, -learned, learned), share)


def blend(prior: Prior, learned: HeadMaps) -> HeadMaps:
    """The learned maps over the prior by their shares c: (1 - c) prior + c learned of disparity, scale and opacity.

    Disparity is blended, not depth: errors of matching are even in it. Where the prior has no surface every map is 0.
    """
    shares = torch.where(prior.surface, learned.shares, 0)
    of_disparity, c = shares.split(1, dim=1)
    if learned.rotation.shape[1] == 4:
        rotation = blend_quaternions(quaternion_of(prior.normal), learned.rotation, c)
    else:
        rotation = blend_directions(prior.normal, learned.rotation, c)
    disparity, scale, opacity = (
        (1 - share) * p + share * n
        for share, p, n in (
            (of_disparity, prior.disparity, learned.disparity),
            (c, prior.scale, learned.scale),
            (c, prior.opacity, learned.opacity),
        )
    )
    return HeadMaps(disparity, scale, rotation, opacity, shares)


class Heads(nn.Module):
    """Heads, each a 3x3 convolution, ReLU and a 1x1 convolution; with `upscale` 2 a pixel shuffle brings them to full
    resolution.

    The paper's five of scale, rotation, opacity, depth and confidence, and one that says at every pixel how much of the
    refinement's move, which is known a cell at a time, is taken. The paper blends by the confidence itself. Here the
    confidence is a probability, and beside it the same head says two shares to blend by: blended by a probability of
    .43, which is what three in seven pixels of a good start amount to, a learned depth 18 % nearer to the truth than
    the start came out only 14 % nearer.
    """

    def __init__(
        self,
        channels: int,
        rotation: RotationKind = "normal",
        opacity: Literal[1, 2] = 2,
        upscale: int = 1,
        reach: float = 2.0,
        hidden: int = 32,
    ) -> None:
        """Heads over decoder features of so many channels.

        `upscale` is the stem's stride, `reach` the most that the disparity may move, px, `hidden` the width of every
        head.
        """
        super().__init__()
        self.rotation, self.upscale, self.reach = rotation, upscale, reach
        outputs = {
            "move": 1,
            "disparity": 1,
            "scale": 3,
            "rotation": 3 if rotation == "normal" else 4,
            "opacity": opacity,
            "confidence": 3,
        }
        # The 3x3 convolutions of all heads as one: six times the channels cost less than six passes over the picture.
        self.first = nn.Conv2d(channels, len(outputs) * hidden, 3, padding=1)
        self.last = nn.ModuleDict({name: pointwise(hidden, n * upscale**2) for name, n in outputs.items()})
        for name, last in self.last.items():
            weight, bias = last.parameters()
            nn.init.zeros_(weight)
            nn.init.constant_(bias, CONFIDENCE_BIAS if name == "confidence" else 0.0)

    def numbers(self, features: torch.Tensor) -> dict[str, torch.Tensor]:
        """What each head says, [B, n, h, w] float32 at full resolution, of features [B, C, h / upscale, w / upscale];
        `learned` gives it its meaning. `shares` are the second and third number of the confidence's head.

        The layers that say it are float32 even under autocast.
        """
        hidden = torch.relu_(self.first(features)).chunk(len(self.last), dim=1)
        with torch.autocast(features.device.type, enabled=False):
            said = {
                name: shuffled(last(h.to(exact(h.dtype))), self.upscale)
                for (name, last), h in zip(self.last.items(), hidden, strict=True)
            }
        said["confidence"], said["shares"] = said["confidence"].split([1, 2], dim=1)
        return said

    def forward(self, features: torch.Tensor, prior: Prior, rays: torch.Tensor) -> HeadMaps:
        """The learned maps, not yet blended: features [B, C, h / upscale, w / upscale], rays [B, 3, h, w] unit, from
        the camera.

        Raises ValueError where the resolutions do not meet.
        """
        height, width = prior.normal.shape[-2:]
        if (features.shape[-2] * self.upscale, features.shape[-1] * self.upscale) != (height, width):
            raise ValueError(
                f"features of {tuple(features.shape[-2:])} pixels with upscale {self.upscale} do not give the prior's"
                f" {height} x {width}"
            )
        return learned(self.numbers(features), prior, rays, self.reach)


def learned(numbers: Mapping[str, torch.Tensor], prior: Prior, rays: torch.Tensor, reach: float) -> HeadMaps:
    """The learned maps that the heads' numbers stand for, not yet blended; `reach` as in `Heads`. 0 where the prior
    has no surface."""
    with torch.autocast(prior.normal.device.type, enabled=False):
        x = numbers["rotation"]
        rotation = learned_normal(x, prior.normal, rays) if x.shape[1] == 3 else learned_quaternion(x, prior.normal)
        maps = (
            prior.disparity + limited(numbers["disparity"], reach),
            learned_scale(numbers["scale"], prior.scale),
            rotation,
            learned_opacity(numbers["opacity"], prior.opacity),
            trust(numbers["shares"]),
        )
        return HeadMaps(*(torch.where(prior.surface, m, 0) for m in maps))


def moved(numbers: Mapping[str, torch.Tensor], move: torch.Tensor, reach: float) -> torch.Tensor:
    """Learned change of the disparity [B, 1, h, w], px:
    a share of the refinement's move [B, 1, h, w], and the head's own."""
    return torch.sigmoid(limited(numbers["move"])) * move + limited(numbers["disparity"], reach)


def trust(x: torch.Tensor) -> torch.Tensor:
    """Confidence or share 0..1 of a number of the confidence's head; its slope never vanishes."""
    return torch.sigmoid(limited(x))
