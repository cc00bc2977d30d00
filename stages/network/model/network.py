"""The whole network: encoders, fusion, recurrent refinement of the disparity, decoder and heads.

    pictures, heatmaps -> features -> correlation -> D(1) ... D(T)  (stages/network/model/refine.py)
    heatmaps, stabilised over time -> pose encoder
    a third view's picture and heatmaps -> features, looked up by warping in each step,
        where the preset has `further_views`
    D(T), what speaks for it -> depth encoder -> decoder with joint skips -> heads

Everything it says is relative to the analytic start: heads of 0 and shares of 0 give the start itself.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

import torch
from torch import nn

from posegaussian.stages.network.model.decoder import Decoder
from posegaussian.stages.network.model.encoders import depth_encoder, heatmaps_on, image_encoder, pose_encoder
from posegaussian.stages.network.model.fusion import depth_fusion
from posegaussian.stages.network.model.heads import Heads, moved, trust
from posegaussian.stages.network.model.layout import unshuffled
from posegaussian.stages.network.model.pairs import EVIDENCE, RELIEF, PairViews, Third, evidence, others, relief
from posegaussian.stages.network.model.presets import Preset
from posegaussian.stages.network.model.quarters import Quarters
from posegaussian.stages.network.model.refine import DepthRefinement
from posegaussian.stages.network.model.warping import in_cells

OF_DEPTH = EVIDENCE + 3
"""Channels the depth encoder sees: the relief, the move from the start,
the refinement's own trust, and the evidence."""
Timer = Callable[[str], AbstractContextManager[None]]
"""Name of a module -> a context that measures it."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the network says of B directions."""

    disparities: list[torch.Tensor]
    """[B, 1, H, W] px after each step of refinement,
    the last one the best (only that one where no more was asked for)."""
    trust: torch.Tensor
    """[B, 1, H, W] 0..1 of the refinement in its last step over the start."""
    numbers: dict[str, torch.Tensor]
    """Of the heads, [B, n, H, W] float32; see `posegaussian.stages.network.model.heads.learned`."""
    change: torch.Tensor
    """[B, 1, H, W] px: what would be added to the start if its share were 1."""
    disparity: torch.Tensor
    """[B, 1, H, W] px: the start and the change times its share; NaN where there is no start."""
    joint: torch.Tensor
    """[B, C, h, w] f_joint, for the loss of pose fusion."""
    pose: torch.Tensor | None
    """[B, C, h, w] f_pose; None where the decoder does not see the pose."""

    def to(self, device: torch.device) -> Prediction:
        """The same on a device."""
        moved = {n: v.to(device) for n, v in vars(self).items() if isinstance(v, torch.Tensor)}
        disparities, numbers = (
            [d.to(device) for d in self.disparities],
            {n: v.to(device) for n, v in self.numbers.items()},
        )
        return replace(self, disparities=disparities, numbers=numbers, **moved)

    def in_rows(self, turned: Quarters, rotation: str) -> Prediction:
        """The same of the rectified pictures and along their axes, said of pictures `turned` to stand upright;
        `rotation`: the kind of the head."""
        if not any(turned.turns):
            return self
        first = 1 if rotation == "quaternion" else 0
        numbers = {n: turned.in_rows(v) for n, v in self.numbers.items()}
        numbers["scale"] = turned.along_rows(numbers["scale"], (0, 1), signed=False)
        numbers["rotation"] = turned.along_rows(numbers["rotation"], (first, first + 1), signed=True)
        maps = {n: turned.in_rows(v) for n, v in vars(self).items() if isinstance(v, torch.Tensor)}
        return replace(self, disparities=[turned.in_rows(d) for d in self.disparities], numbers=numbers, **maps)

    @property
    def confidence(self) -> torch.Tensor:
        """[B, 1, H, W] 0..1 probability that the start with the change is nearer to the truth than the start."""
        return trust(self.numbers["confidence"])

    @property
    def shares(self) -> torch.Tensor:
        """[B, 2, H, W] 0..1 of the learned value in the blend: of disparity, and of scale, rotation and opacity."""
        return trust(self.numbers["shares"])


class PoseGaussianNetwork(nn.Module):
    """A network of a preset; see the file's head."""

    def __init__(self, preset: Preset, joints: int = 17) -> None:
        super().__init__()
        self.preset, self.joints = preset, joints
        last = preset.widths[-1]
        self.image = image_encoder(preset)
        self.fusion = depth_fusion(preset, joints)
        # The start's finest detail, a cell of the features at a time: nothing of it is lost before the context sees it.
        self.beside = nn.Conv2d((EVIDENCE + 1) * preset.stride**2, preset.widths[1], 3, padding=1)
        self.refinement = DepthRefinement(
            last,
            preset.hidden,
            preset.correlation_levels,
            preset.correlation_radius,
            preset.stride,
            preset.further_views,
            beside=preset.widths[1],
            alone=preset.alone,
        )
        self.pose = pose_encoder(preset, joints) if "decoder" in preset.pose_in else None
        self.depth = depth_encoder(preset, OF_DEPTH)
        channels = self.image.channels
        poses = () if self.pose is None else self.pose.channels
        self.finer = len(channels) - len(poses)
        self.decoder = Decoder(
            last + preset.hidden, channels, channels, (*[0] * self.finer, *poses), channels, preset.normalisation
        )
        self.heads = Heads(
            channels[0],
            preset.rotation_head,
            2 if preset.opacity_head == "facing" else 1,
            preset.stem_stride,
            hidden=channels[0],
        )

    @property
    def device(self) -> torch.device:
        """Where its weights lie."""
        return next(self.parameters()).device

    def forward(
        self, views: PairViews, iterations: int, only_last: bool = False, timer: Timer | None = None
    ) -> Prediction:
        """Refine the start of every direction in `iterations` steps and decode.

        Pictures are looked at upright (`PairViews.turned`); what is said is of the rectified ones, along their axes. H
        and W are multiples of the preset's stride, those of a third view too. Raises ValueError for sizes that are
        not, for `iterations` < 1, and for a third view, or a view alone, that the preset does not have.
        """
        clock = timer or (lambda name: nullcontext())
        turned = views.quarters
        with clock("evidence"):
            seen = turned.upright(evidence(views))
        views = views.upright()
        known = views.known
        start = torch.where(known, views.start, 0)
        with clock("image encoder"):
            levels = self.image(views.color)
        with clock("fusion"):
            fused = self.fusion(levels[-1], heatmaps_on(views.heatmaps, self.preset.stride))
        further: list[tuple[torch.Tensor, torch.Tensor]] = []
        if views.third is not None:
            with clock("third view"):
                further = [self._further(views.third)]
        with clock("refinement"):
            told = unshuffled(torch.cat([relief(start, known), seen], dim=1), self.preset.stride)
            refined = self.refinement(
                fused,
                None if views.all_alone else others(fused),
                views.start,
                views.coding,
                iterations,
                further,
                only_last=only_last,
                beside=torch.relu(self.beside(told)),
                alone=views.alone,
                turned=turned,
            )
        pose = None
        if self.pose is not None:
            with clock("pose encoder"):
                pose = self.pose(heatmaps_on(views.of_pose, self.preset.pose_cell))
        last = refined.disparities[-1]
        move = torch.where(known, last - start, 0)
        with clock("depth encoder"):
            shown = torch.cat([relief(last, known), (move / RELIEF).clamp(-2, 2), refined.confidence, seen], dim=1)
            depth = self.depth(shown.detach())
        with clock("decoder"):
            decoded = self.decoder(
                torch.cat([fused, refined.state], dim=1), levels, depth, [*[None] * self.finer, *(pose or ())]
            )
        with clock("heads"):
            numbers = self.heads.numbers(decoded.features)
            change = moved(numbers, move, self.heads.reach)
            disparity = torch.where(known, start + trust(numbers["shares"][:, :1]) * change, torch.nan)
        said = Prediction(
            refined.disparities,
            refined.confidence,
            numbers,
            change,
            disparity,
            decoded.joint,
            None if pose is None else pose[-1],
        )
        return said.in_rows(turned, self.preset.rotation_head)

    def _further(self, third: Third) -> tuple[torch.Tensor, torch.Tensor]:
        """Features [2 P, C, h, w] of the third view of every direction's pair, and the projection of cells to its
        cells [2 P, 3, 4]."""
        features = self.fusion(self.image(third.color)[-1], heatmaps_on(third.heatmaps, self.preset.stride))
        return features.repeat_interleave(2, dim=0), in_cells(third.projection, self.preset.stride, self.image.lag)

    def last_layers(self) -> list[nn.Parameter]:
        """Weights and biases of the layers that begin at zero, or at a constant:
        those that say what is changed of the start."""
        update = self.refinement.update
        ends: list[nn.Module] = [*self.heads.last.values(), update.delta, update.mask, self.refinement.confidence]
        return [p for end in ends for p in list(end.parameters())[-2:]]
