"""Ways in which image features f and pose heatmaps p of the same grid become one feature map of f's width.

With P a 1x1 and W, Wg 3x3 convolutions, all learnt, and sigma the logistic function:

    concatenation   W [f, p]
    attention       W (a * [f, p]), a per channel from the means of all (Hu et al. 2018),
                    feature-wise as Zhang et al. 2021
    gated           W (z * f + (1 - z) * P p), z = sigma(Wg [f, p])  (Arevalo et al. 2017)
    addition        W (f + P p)
    multiplication  W (f * (1 + P p))
    weighted        W (w * f + (1 - w) * P p), w per channel
    outer           W (f + P p) + Wg ((R f) (x) [p, 1]), R to a quarter of the width in each cell

P has no bias and the products keep a 1, so that heatmaps of zeros (nobody found) bring nothing and take nothing from
the picture but a scale. Nothing is normalised or rectified behind W: the features are compared by their products.
"""

from __future__ import annotations

import torch
from torch import nn

from posegaussian.stages.network.model.encoders import SQUEEZE, SqueezeExcitation
from posegaussian.stages.network.model.presets import GROUP, FusionKind, Preset


def depth_fusion(preset: Preset, joints: int = 17) -> Fusion | ImageOnly:
    """What makes the features that are correlated: of pictures and `joints` heatmaps, or of pictures alone where
    pose is not in the depth."""
    width = preset.widths[-1]
    return FUSIONS[preset.fusion](width, joints) if "depth" in preset.pose_in else ImageOnly(width, joints)


class Fusion(nn.Module):
    """[B, image, h, w] and [B, pose, h, w] -> [B, image, h, w]."""

    def __init__(self, image: int, pose: int) -> None:
        super().__init__()
        self.image, self.pose = image, pose

    def forward(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """Raises ValueError where the channels are not those declared or batch, height and width differ:
        nothing is broadcast."""
        if image.ndim != 4 or pose.ndim != 4 or image.shape[1] != self.image or pose.shape[1] != self.pose:
            raise ValueError(
                f"image {tuple(image.shape)} and pose {tuple(pose.shape)} do not fuse; [B, {self.image}, h, w] and [B,"
                f" {self.pose}, h, w]"
            )
        if image.shape[0] != pose.shape[0] or image.shape[2:] != pose.shape[2:]:
            raise ValueError(
                f"image {tuple(image.shape)} and pose {tuple(pose.shape)} differ in batch, height or width; bring the"
                " pose to the image's grid first"
            )
        return self.fuse(image, pose)

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """The kind's equation, on shapes that fit."""
        raise NotImplementedError


class ImageOnly(Fusion):
    """The picture's features alone; the pose is not read."""

    def __init__(self, image: int, pose: int) -> None:
        super().__init__(image, pose)
        self.out = _conv3(image, image)

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """W f."""
        return self.out(image)


class Concatenation(Fusion):
    """Stacked channels."""

    def __init__(self, image: int, pose: int) -> None:
        super().__init__(image, pose)
        self.out = _conv3(image + pose, image)

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """W [f, p]."""
        return self.out(torch.cat([image, pose], 1))


class Attention(Concatenation):
    """Stacked channels, each weighted by what all of them are on the whole picture."""

    def __init__(self, image: int, pose: int) -> None:
        super().__init__(image, pose)
        both = image + pose
        self.attention = SqueezeExcitation(both, hidden=-(-both // (SQUEEZE * GROUP)) * GROUP)

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """W (a * [f, p])."""
        return self.out(self.attention(torch.cat([image, pose], 1)))


class _Projected(Fusion):
    """The pose brought to the picture's channels, then combined cell by cell."""

    def __init__(self, image: int, pose: int) -> None:
        super().__init__(image, pose)
        self.project = nn.Conv2d(pose, image, 1, bias=False)
        self.out = _conv3(image, image)


class Addition(_Projected):
    """Cell by cell."""

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """W (f + P p)."""
        return self.out(image + self.project(pose))


class Multiplication(_Projected):
    """Cell by cell."""

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """W (f * (1 + P p)). With P p alone, pictures would vanish wherever there is no joint."""
        return self.out(image * (1 + self.project(pose)))


class WeightedAverage(_Projected):
    """A learnt share of each."""

    def __init__(self, image: int, pose: int) -> None:
        super().__init__(image, pose)
        self.weight = nn.Parameter(torch.zeros(image, 1, 1))

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """W (w * f + (1 - w) * P p); w begins at a half."""
        return self.out(
            torch.lerp(self.project(pose).to(image.dtype), image, torch.sigmoid(self.weight).to(image.dtype))
        )


class Gated(_Projected):
    """A share of each that follows from both, per cell and channel."""

    def __init__(self, image: int, pose: int) -> None:
        super().__init__(image, pose)
        self.gate = _conv3(image + pose, image)

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """W (z * f + (1 - z) * P p)."""
        z = torch.sigmoid(self.gate(torch.cat([image, pose], 1)))
        return self.out(z * image + (1 - z) * self.project(pose))


class OuterProduct(_Projected):
    """Every product of a picture's feature and a joint, at a quarter of the picture's width."""

    def __init__(self, image: int, pose: int) -> None:
        super().__init__(image, pose)
        reduced = max(image // SQUEEZE, 1)
        # A product of matrices: the same as a 1x1 convolution rounds otherwise with more threads.
        self.reduce = nn.Linear(image, reduced, bias=False)
        self.products = nn.Conv2d(reduced * (pose + 1), image, 3, padding=1, bias=False)

    def fuse(self, image: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        """W (f + P p) + Wg ((R f) (x) [p, 1])."""
        one = torch.ones_like(pose[:, :1])
        reduced = self.reduce(image.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        products = (reduced[:, :, None] * torch.cat([pose, one], 1)[:, None]).flatten(1, 2)
        return self.out(image + self.project(pose)) + self.products(products)


FUSIONS: dict[FusionKind, type[Fusion]] = {
    "concatenation": Concatenation,
    "attention": Attention,
    "gated": Gated,
    "addition": Addition,
    "multiplication": Multiplication,
    "weighted": WeightedAverage,
    "outer": OuterProduct,
}


def _conv3(inputs: int, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1)
