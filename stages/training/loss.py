"""The loss of a step: depth alone, or depth and the picture that a camera between both views sees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional

from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.gaussians.prior import rays
from posegaussian.stages.gaussians.run import prior
from posegaussian.stages.network.losses import PoseFusion, masked_mean, render_loss, sequence_loss
from posegaussian.stages.network.model.heads import HeadMaps, Prior, blend, learned, limited, normal_of, twist_of
from posegaussian.stages.network.model.network import PoseGaussianNetwork, Prediction
from posegaussian.stages.network.model.pairs import PairViews
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.splatting.definition.scene import Drawing, Gaussians
from posegaussian.stages.splatting.rasterizer import rasterize
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.examples import Example

OUTSIDE = 0.25
"""Weight of a target's pixels beside the subject: what is drawn there is clipped by the silhouettes later."""


class LossTerms(NamedTuple):
    """Parts of the loss, each with its weight in it."""

    depth: torch.Tensor
    """Sequence of the refinement, its trust, and the disparity that comes out."""
    pose: torch.Tensor
    """Alignment of joint and pose features, and the heatmaps read back."""
    render: torch.Tensor
    """0 in the first phase."""

    @property
    def total(self) -> torch.Tensor:
        """What is minimised."""
        return self.depth + self.pose + self.render


class Batch(NamedTuple):
    """Examples as one, on a device."""

    views: PairViews
    truth: torch.Tensor
    """[B, 1, H, W] true disparity, px, 0 where there is none."""
    valid: torch.Tensor
    """[B, 1, H, W] bool, where both the truth and the start are known."""
    strange: torch.Tensor
    """[B, 1, 1, 1] bool, of the directions whose two views do not fit each other."""


def together(examples: Sequence[Example], device: torch.device) -> Batch:
    """Examples of one size as a batch."""
    views, truth = (
        PairViews.batch([e.views for e in examples]).to(device),
        torch.cat([e.truth for e in examples]).to(device),
    )
    strange = torch.tensor([e.strange for e in examples for _ in (0, 1)], device=device)
    return Batch(
        views,
        torch.where(torch.isfinite(truth), truth, 0),
        torch.isfinite(truth) & views.known,
        strange[:, None, None, None],
    )


def depth_terms(prediction: Prediction, batch: Batch, config: TrainingConfig) -> torch.Tensor:
    """Of the sequence, of the trust that blends its last step over the start, of the learned disparity, of what comes
    out, of the confidence, and of shares where nothing can be learnt.

    The confidence is the probability that the learned disparity is nearer to the truth than the start: its cross
    entropy with whether it is, and nothing else, teaches it (Kendall and Gal 2017 weigh the error by it instead, and
    what then comes out is no probability). The shares learn from what comes out, disparity and picture. Where the views
    do not fit, nothing is asked of what is learnt, but that neither confidence nor a share goes with it.
    """
    views, truth, valid = batch.views, batch.truth, batch.valid
    fits = valid & ~batch.strange
    start, last = torch.where(valid, views.start, 0), prediction.disparities[-1].detach()
    blended = start + prediction.trust * (last - start)
    parts = (
        (config.trust, blended, valid),
        (config.learned, start + prediction.change, fits),
        (config.blended, torch.where(valid, prediction.disparity, 0), fits),
    )
    logit = limited(prediction.numbers["confidence"])
    better = beats(prediction, batch).to(logit.dtype)
    confidence = masked_mean(functional.binary_cross_entropy_with_logits(logit, better, reduction="none"), valid)
    shares = limited(prediction.numbers["shares"])
    silence = masked_mean(functional.softplus(shares), valid & batch.strange)  # the cross entropy with 0
    return (
        sequence_loss(prediction.disparities, truth, fits, config.mu)
        + config.confidence * confidence
        + config.silence * silence
        + torch.stack([w * masked_mean((d - truth).abs(), where) for w, d, where in parts]).sum()
    )


def beats(prediction: Prediction, batch: Batch) -> torch.Tensor:
    """[B, 1, H, W] bool: whether the learned disparity is nearer to the truth than the start; never where the views do
    not fit each other, where it could only be luck."""
    start, change = torch.where(batch.valid, batch.views.start, 0), prediction.change.detach()
    nearer = (start + change - batch.truth).abs() < (start - batch.truth).abs()
    return nearer & batch.valid & ~batch.strange


def pose_terms(
    fusion: PoseFusion | None, prediction: Prediction, views: PairViews, config: TrainingConfig
) -> torch.Tensor:
    """Zero where the decoder does not see the pose."""
    if fusion is None or prediction.pose is None:
        return prediction.joint.new_zeros(())
    found = fusion(prediction.joint, prediction.pose, views.of_pose)
    return found.alignment + config.heatmaps * found.heatmaps


def render_terms(
    network: PoseGaussianNetwork,
    prediction: Prediction,
    examples: Sequence[Example],
    config: TrainingConfig,
    threads: int = 1,
) -> torch.Tensor:
    """Mean over the pairs of the loss of the picture between both views."""
    found = []
    for i, example in enumerate(examples):
        maps = [gaussian_maps(network, prediction, example, 2 * i + w, w) for w in (0, 1)]
        picture = draw(example, maps, threads)
        weight = torch.where(example.cover > 0, 1.0, OUTSIDE).to(picture.device)
        found.append(render_loss(picture, example.seen.to(picture.device), weight, config.beta, config.gamma))
    return config.render * torch.stack(found).mean()


def gaussian_maps(
    network: PoseGaussianNetwork, prediction: Prediction, example: Example, direction: int, which: int
) -> GaussianMaps:
    """What the Gaussians of one direction are lifted from: the blend over the analytic prior on the rectified grid."""
    disparity = prediction.disparity[direction : direction + 1]
    there = torch.isfinite(disparity)
    depth = torch.where(there, example.views.coding.only(which).depth(torch.where(there, disparity, 0)), 0)
    analytic, ray = _prior(example, which, depth.detach()[0, 0].cpu().numpy())
    analytic, ray = Prior(*(m.to(disparity.device) for m in analytic)), ray.to(disparity.device)
    numbers = {name: x[direction : direction + 1] for name, x in prediction.numbers.items()}
    blended: HeadMaps = blend(analytic, learned(numbers, analytic, ray, network.heads.reach))
    turn = blended.rotation
    return GaussianMaps(
        example.picture[which],
        depth[0, 0],
        blended.scale[0],
        normal_of(turn)[0],
        blended.opacity[0],
        twist_of(turn)[0] if turn.shape[1] == 4 else None,
    )


def draw(example: Example, maps: Sequence[GaussianMaps], threads: int) -> torch.Tensor:
    """[1, 3, h, w] the picture of the target camera, premultiplied."""
    parts = []
    for which, m in enumerate(maps):
        assert isinstance(m.depth, torch.Tensor)
        camera = example.cameras[which]
        lifted = lift(
            m, np.asarray(camera.intrinsics), np.asarray(camera.world_to_camera), torch.float32, m.depth.device
        )
        parts.append(lifted.seen_from(example.target))
    drawn = rasterize(Gaussians.concatenate(parts), [example.target], drawing=Drawing(threads=threads))
    return drawn.color[0].permute(2, 0, 1)[None].clamp(0, 1)


def _prior(example: Example, which: int, depth: np.ndarray) -> tuple[Prior, torch.Tensor]:
    """The analytic prior of a depth [H, W] on one view's rectified window, as the gaussians stage makes it, and unit
    rays [1, 3, H, W]."""
    views, k = example.views, np.asarray(example.cameras[which].intrinsics)
    mask = np.round(255 * views.cover[which, 0].numpy()).astype(np.uint8)
    scale, normal, opacity = (
        torch.from_numpy(np.ascontiguousarray(m, np.float32))[None]
        for m in prior(depth, views.confidence[which, 0].numpy(), mask, k, GaussiansParams())
    )
    directions = rays(k, *depth.shape)
    unit = directions / np.sqrt((directions**2).sum(axis=0))
    return Prior(torch.zeros_like(scale[:, :1]), scale, normal, opacity), torch.from_numpy(unit)[None]
