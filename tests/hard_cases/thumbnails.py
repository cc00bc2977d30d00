"""What some hard cases look like, naive and ours: small pictures for the page."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.matching.fuse import transfer
from posegaussian.stages.matching.sampling import disagreement
from posegaussian.stages.rendering.run import quantise
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians
from tests.hard_cases import naive
from tests.hard_cases.cases_depth import ORIGIN, hidden_matches, hidden_scene, matches, naive_matches
from tests.hard_cases.cases_pictures import COLUMN, EDGE_ON, before_white, wrapped
from tests.hard_cases.cases_pose import pairwise_plain, swapped
from tests.stages.smoothing.test_smoothing import smooth
from tests.support.gaussian_scenes import camera, cloud, draw, gaussians

NO_NUMBER = (255, 96, 200)
"""Red, green, blue of pixels that are NaN or infinite."""
LARGE = camera(144, 120, 150.0)
Pair = tuple[str, np.ndarray, np.ndarray]
"""A title, and two pictures [h, w, 3] uint8."""


def shown(picture: torch.Tensor) -> np.ndarray:
    """Bytes of a picture [h, w, 3]; what is no number stands out."""
    found = picture.detach().numpy()
    out = quantise(torch.nan_to_num(picture.detach(), nan=0.0, posinf=0.0, neginf=0.0))
    out[~np.isfinite(found).all(axis=-1)] = NO_NUMBER
    return out


def both(title: str, g: Gaussians, cam: Camera, cutoffs: Cutoffs | None = None) -> Pair:
    """The same Gaussians, drawn by the textbook and by us."""
    return title, shown(naive.splat(g, cam)[0]), shown(draw(g, cam, cutoffs).color)


def subject() -> Gaussians:
    """A cloud with room around it."""
    g = cloud(60, seed=3, dtype=torch.float32)
    return Gaussians(g.mean * torch.tensor([0.7, 0.7, 1.0]), g.rotation, g.scale * 0.7, g.opacity, g.color)


def with_one(mean: list[float], scale: object, color: tuple[float, float, float] = (0.2, 0.5, 1.0)) -> Gaussians:
    """The cloud, and one Gaussian that is a hard case."""
    return Gaussians.concatenate([subject(), gaussians(mean, scale, 0.8, color, dtype=torch.float32)])


def half_pixel() -> Pair:
    """Four by four pixels and a Gaussian that belongs into the middle of one; a cross marks its true place."""
    g, cam = gaussians([0.0, 0.0, 2.0], 0.02, 1.0, (1.0, 1.0, 1.0), dtype=torch.float32), camera(9, 8, 50.0, 4.5, 3.5)
    pictures = []
    for picture in (naive.splat(g, cam, centre=0.0)[0], draw(g, cam).color):
        big = cv2.resize(shown(picture), (180, 160), interpolation=cv2.INTER_NEAREST)
        cv2.drawMarker(big, (90, 70), (220, 40, 40), cv2.MARKER_CROSS, 22, 2)
        pictures.append(big)
    return "S16 half a pixel", pictures[0], pictures[1]


def rims() -> Pair:
    color, alpha, _ = before_white()
    return "S18 before a white background", shown(alpha * color + (1 - alpha)), shown(color + (1 - alpha))


def bytes_of() -> Pair:
    bright = draw(subject(), LARGE).color * 2.2 - 0.1
    return "S21 values above 1 and below 0", wrapped(bright).reshape(*bright.shape), quantise(bright)


def depth_picture(depth: np.ndarray) -> np.ndarray:
    """Near is warm, 0 is black."""
    share = np.clip((2.2 - depth) / 1.4, 0, 1)
    return np.where(
        (depth > 0)[..., None],
        cv2.applyColorMap(np.rint(255 * share).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1],
        0,
    ).astype(np.uint8)


def background() -> Pair:
    """Disparity brought to the depths of a sphere 1.4 to 2 m away, and our depth."""
    disparity, _ = naive_matches()
    return (
        "D13 a black background",
        depth_picture(np.where(disparity > -33, np.clip(1.7 - disparity / 40, 0.8, 2.2), 0)),
        depth_picture(matches()),
    )


def edge_on() -> Pair:
    """A disc without thickness, turned by 89.99 degrees."""
    return (
        "S22 a disc seen edge-on",
        shown(naive.splat(EDGE_ON[0], COLUMN)[0]),
        shown(draw(EDGE_ON[0], COLUMN, Cutoffs(low_pass=0.3, compensation=True)).color),
    )


def hidden() -> Pair:
    """Depth of a small sphere before a large one, before and after the other side was asked."""
    rig = hidden_scene()[0]
    found = hidden_matches()
    held = (
        disagreement(found[0], found[1], transfer(rig, 0, 1), rectify(rig, 0, 1, ORIGIN).sensitivity)
        <= DepthParams().consistency
    )
    return "D14 what the other camera cannot see", depth_picture(found[0]), depth_picture(np.where(held, found[0], 0))


def twins() -> Pair:
    """One joint's heatmap in the frame after left and right changed places."""
    arrays = swapped()
    maps = (
        pairwise_plain(arrays["pose/heatmaps"].astype(np.float64), 0.5),
        smooth(arrays, method="adaptive", omega=0.5),
    )
    a, b = (
        cv2.applyColorMap(np.rint(255 * m[1, 0, 0].astype(np.float64)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[
            ..., ::-1
        ]
        for m in maps
    )
    return "P5 left and right change places", a, b


def thumbnails() -> list[Pair]:
    """All of them."""
    needle = with_one([0.1, 0.05, 2.0], [[0.9, 0.00004, 0.00004]])
    c = float(np.sqrt(0.5))
    needle.rotation[-1] = torch.tensor([[c, -c, 0], [c, c, 0], [0, 0, 1.0]])
    return [
        both("S1 a point behind the camera", with_one([0.1, 0.05, -0.5], 0.05), LARGE),
        both("S2 a ball far beside the picture", with_one([3.0, 0.3, 0.3], 0.2), LARGE),
        both("S5, S6 a needle", needle, LARGE, Cutoffs(low_pass=0.3)),
        both("S13 one Gaussian is NaN", with_one([float("nan"), 0.0, 2.0], 0.05), LARGE),
        half_pixel(),
        rims(),
        bytes_of(),
        both("S12 a scale of 1e30 m", with_one([0.0, 0.0, 3.9], 1e30), LARGE),
        edge_on(),
        background(),
        hidden(),
        twins(),
    ]
