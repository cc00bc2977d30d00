"""Pairs of views with known answers, random views, and networks that say something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from posegaussian.stages.geometry.projection import pixel_centres, rays, unproject
from posegaussian.stages.geometry.rectification import RectifiedPair, Window, rectify
from posegaussian.stages.network.model.disparity import Coding
from posegaussian.stages.network.model.network import PoseGaussianNetwork
from posegaussian.stages.network.model.pairs import PairViews, SourceView
from posegaussian.stages.network.model.presets import PRESETS
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of

UPRIGHT = np.array([1.0, 0.2, 0.1]), 0.05
"""A plane through the subject that both cameras see from its front: n, not unit, and d of n.X = d."""
DISC = 0.45
"""Metres around the origin that the planes reach."""


def two_cameras(size: tuple[int, int] = (128, 128), angles: tuple[float, ...] = (-12.0, 12.0)) -> Rig:
    """Cameras on a ring of 2 m, whose shorter side sees about 1.1 m of the subject."""
    return rig_of([camera(on_ring(a), np.zeros(3)) for a in angles], size, focal=1.8 * min(size))


def plane_depth(rig: Rig, view: int, plane: tuple[np.ndarray, float] = UPRIGHT, disc: float = DISC) -> np.ndarray:
    """[h, w] float32 depth along the optical axis at the pixel centres, 0 beside the disc."""
    return depth_of_plane(rig.intrinsics[view], rig.world_to_camera[view], tuple(rig.size[view]), plane, disc).astype(
        np.float32
    )


def depth_of_plane(
    intrinsics: np.ndarray, pose: np.ndarray, size: tuple[int, int], plane: tuple[np.ndarray, float], disc: float
) -> np.ndarray:
    normal, distance = plane
    origin, directions = rays(pixel_centres(size), intrinsics, pose)
    depth = (distance - normal @ origin) / (directions @ normal)
    return np.where(np.linalg.norm(unproject(depth, intrinsics, pose), axis=-1) < disc, depth, 0.0)


def plane_disparity(
    pair: RectifiedPair, which: int, window: Window, other: Window, plane: tuple[np.ndarray, float]
) -> np.ndarray:
    """[H, W] px between windows of an endless plane, from the rectified cameras alone."""
    intrinsics = pair.intrinsics[which].copy()
    intrinsics[:2, 2] -= window[:2]
    depth = depth_of_plane(intrinsics, pair.world_to_camera(which), window[2:], plane, np.inf)
    return (1 if which == 0 else -1) * pair.disparity(depth) - (window[0] - other[0])


def source(rig: Rig, view: int, depth: np.ndarray) -> SourceView:
    """A view of a depth, coloured by a smooth function of the point in space, some 25 px a wave at 128 px."""
    points = unproject(depth, rig.intrinsics[view], rig.world_to_camera[view])
    color = np.stack([np.sin(points @ np.array(k)) for k in ((0, 28.0, 9), (0, 11, 30), (0, -23, 21))], axis=-1)
    mask = np.where(depth > 0, 255, 0).astype(np.uint8)
    return SourceView(
        np.where((depth > 0)[..., None], np.rint(127.5 + 120 * color), 0).astype(np.uint8),
        mask,
        depth.astype(np.float32),
        (depth > 0).astype(np.float16),
        None,
    )


def pair_of(rig: Rig) -> RectifiedPair:
    return rectify(rig, 0, 1, np.zeros(3))


def random_views(pairs: int, side: int = 64, seed: int = 0) -> PairViews:
    """Pictures and heatmaps of noise over smooth starts with a hole."""
    g = torch.Generator().manual_seed(seed)
    batch = 2 * pairs
    scale = torch.tensor([600.0, -600.0] * pairs, dtype=torch.float64)
    coding = Coding(
        scale,
        torch.zeros(batch, dtype=torch.float64),
        torch.full((batch,), 1.5, dtype=torch.float64),
        torch.full((batch,), 100.0, dtype=torch.float64),
    )
    slope = torch.linspace(250, 320, side)[None, None, None, :].expand(batch, 1, side, side) + 5 * torch.rand(
        batch, 1, side, side, generator=g
    )
    start = (slope * torch.sign(scale).float()[:, None, None, None]).contiguous()
    start[..., 10:20, 30:50] = torch.nan
    color, cover = torch.rand(batch, 3, side, side, generator=g), torch.ones(batch, 1, side, side)
    heatmaps, confidence = (
        torch.rand(batch, 17, side // 4, side // 4, generator=g),
        torch.rand(batch, 1, side, side, generator=g),
    )
    return PairViews(color, heatmaps, start, torch.where(torch.isfinite(start), confidence, 0), cover, coding)


def network(preset: str = "fast", shaken: bool = True, seed: int = 0, **variant: object) -> PoseGaussianNetwork:
    """An untrained network; `shaken`: its layers that begin at 0 begin at random instead,
    so that every output says something."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        made = PoseGaussianNetwork(replace(PRESETS[preset], **variant)).eval()  # type: ignore[arg-type]
        for p in made.parameters():
            if shaken and p.ndim == 4 and not bool(p.any()):
                torch.nn.init.normal_(p, std=0.02)
    return made.requires_grad_(False)
