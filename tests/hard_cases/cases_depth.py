"""Records R1, R2 and D1-D15: rectification, depth maps, matching and masks.
Cases of the matching network are not there yet."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import torch

from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, hull_only
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.depth.stage import STAGE as DEPTH
from posegaussian.stages.geometry.pairs import classify
from posegaussian.stages.geometry.projection import pixel_centres, project, unproject
from posegaussian.stages.geometry.rectification import RectifiedPair, rectify
from posegaussian.stages.geometry.subject import body_points
from posegaussian.stages.matching.bounds import Bounds
from posegaussian.stages.matching.fuse import complete, fuse, transfer
from posegaussian.stages.matching.sampling import disagreement, fill, sample
from posegaussian.stages.matching.sgbm import match
from posegaussian.stages.metrics.depth_error import depth_error
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import measure
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.storage.model.cameras import Rig, to_integer_centres
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.masks import foreground
from posegaussian.storage.readers.images import read_depth, write_exr, write_png
from tests.hard_cases.catalogue import Case, apart, worst
from tests.support.known_geometry import camera, on_ring, rig_of, ring, sphere_depth, sphere_mask, textured_sphere

ORIGIN = np.zeros(3)
BODY = body_points(ORIGIN, np.array([0, 0, 1.0]))
"""A person in the middle of the ring."""


def pair_rig(azimuth: float, elevation: float = 8.0, roll: float = 0.0) -> Rig:
    """Two cameras 2 m from the origin, 1024 x 1024; the second stands and is turned by these degrees."""
    return rig_of([camera(on_ring(0), ORIGIN, roll), camera(on_ring(azimuth, elevation), ORIGIN, roll)])


VERTICAL = [pair_rig(0, 28), pair_rig(20, 28.5), pair_rig(22.5, roll=90)]
"""One above the other, diagonally above, and both on their side."""
WIDE = [pair_rig(a) for a in (22.5, 45, 60, 67.5, 72, 90)]
OPPOSITE = [pair_rig(a) for a in (120, 150)]
UNEVEN = rig_of([camera(on_ring(0), ORIGIN), camera(on_ring(30, radius=2.6), ORIGIN)])
"""One camera farther away: the baseline is not across the view."""


def opencv(rig: Rig, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Rectified as OpenCV's documents show:
    pixels [2, N, 2] of world points, depth [N] in the first camera, and Tx f."""
    relative = rig.world_to_camera[1] @ np.linalg.inv(rig.world_to_camera[0])
    k = to_integer_centres(rig.intrinsics)
    r0, r1, p0, p1 = cv2.stereoRectify(
        k[0], np.zeros(5), k[1], np.zeros(5), (1024, 1024), relative[:3, :3], relative[:3, 3:], flags=0
    )[:4]
    pixels = []
    for r, p, pose in ((r0, p0, rig.world_to_camera[0]), (r1, p1, rig.world_to_camera[1])):
        seen = (points @ pose[:3, :3].T + pose[:3, 3]) @ r.T @ p[:, :3].T
        pixels.append(seen[:, :2] / seen[:, 2:])
    depth = ((points @ rig.rotations[0].T + rig.world_to_camera[0, :3, 3]) @ r0.T)[:, 2]
    return np.stack(pixels), depth, float(p1[0, 3])


def naive_stereo_depth(rig: Rig) -> float:
    """Tx f over the difference of the columns."""
    pixels, depth, tx = opencv(rig, BODY)
    offset = 0.0 if tx == 0 else float(np.median(pixels[1, :, 0] - pixels[0, :, 0] - tx / depth))
    return apart(tx / (pixels[1, :, 0] - pixels[0, :, 0] - offset), depth)


def stereo_depth_error(rig: Rig) -> float:
    """Of pairs that are called usable; the others are not matched, and the plan says why."""
    if not classify(rig, 0, 1).usable:
        return 0.0
    pair = rectify(rig, 0, 1, ORIGIN)
    (first, depth), (second, _) = (project(BODY, pair.intrinsics[i], pair.world_to_camera(i)) for i in (0, 1))
    return apart(pair.depth(first[:, 0] - second[:, 0]), depth)


def naive_lost(rig: Rig) -> float:
    """Share of the body outside the rectified pictures."""
    pixels = opencv(rig, BODY)[0]
    return 1 - float(((pixels >= 0) & (pixels < 1024)).all(axis=-1).mean())


def lost(rig: Rig) -> float:
    """The same, of pairs that are called usable."""
    if not classify(rig, 0, 1).usable:
        return 0.0
    pair = rectify(rig, 0, 1, ORIGIN)
    seen = [project(BODY, pair.intrinsics[i], pair.world_to_camera(i))[0] for i in (0, 1)]
    return 1 - min(float(((s >= 0) & (s < pair.size)).all(axis=-1).mean()) for s in seen)


DEPTHS = np.array([0.4, 0.499, 0.51, 1.0, 2.0, 3.3])


def naive_stored() -> float:
    """Inverse depth times 2^15 in 16 bits, as one published data set has it."""
    return apart(1 / ((1 / DEPTHS * 2**15).astype(np.int64).astype(np.uint16) / 2**15), DEPTHS)


def stored_error() -> float:
    """Of what is read back; infinite where integers are taken for metres."""
    with tempfile.TemporaryDirectory() as folder:
        file, integers = Path(folder) / "depth.exr", Path(folder) / "depth.png"
        write_exr(file, DEPTHS.astype(np.float32)[None])
        write_png(integers, DEPTHS.astype(np.uint8)[None])
        try:
            read_depth(integers)
        except SourceError:
            return apart(read_depth(file)[0], DEPTHS)
        return np.inf


def naive_flow() -> float:
    """Disparities of a wide pair, as OpenCV rectifies it, in float16: metres of depth."""
    pixels, depth, tx = opencv(pair_rig(60), BODY)
    flow = pixels[1, :, 0] - pixels[0, :, 0]
    offset = float(np.median(flow - tx / depth))
    return apart(tx / (flow.astype(np.float16).astype(float) - offset), depth)


def kept_depth_error() -> float:
    """Depth is what is kept, in the declared type."""
    depth = project(BODY, *(a[0] for a in (pair_rig(60).intrinsics, pair_rig(60).world_to_camera)))[1]
    kept = next(a for a in DEPTH.writes if a.name == "depth/depth")
    return apart(depth.astype(kept.dtype), depth)


def behind_infinity(pair: RectifiedPair) -> np.ndarray:
    """Disparities at infinity and beyond it, px."""
    return pair.offset - np.sign(pair.baseline) * np.array([[0.0, 1e-3, 5.0]])


def naive_farthest() -> float:
    """Depth from 1 / (disparity + 1e-8), the usual guard."""
    pair = rectify(pair_rig(22.5), 0, 1, ORIGIN)
    return float(np.abs(pair.focal * pair.baseline / (behind_infinity(pair) - pair.offset + 1e-8)).max())


def farthest() -> float:
    """Metres to the farthest Gaussian that is made of such pixels; 0 where none is."""
    pair = rectify(pair_rig(22.5), 0, 1, ORIGIN)
    depth = torch.as_tensor(pair.depth(behind_infinity(pair)), dtype=torch.float32)
    maps = GaussianMaps(torch.ones(1, 3, 3), depth, torch.ones(3, 1, 3), -torch.ones(3, 1, 3), torch.ones(2, 1, 3))
    return float(
        np.linalg.norm(lift(maps, np.eye(3), np.eye(4), torch.float32, torch.device("cpu")).mean.numpy(), axis=1).max(
            initial=0.0
        )
    )


def empty_mask_error() -> float:
    """Depth, filling, hull and measures of a picture without a subject."""
    rig = ring(8, (64, 48), 60.0)
    nothing, picture = np.zeros((48, 64), np.float32), np.zeros((48, 64, 3), np.uint8)
    geometry = Geometry.of(rig, tuple(range(8)), DepthParams(method="hull"))
    hull = hull_only(geometry, Frame({}, {v: nothing.astype(np.uint8) for v in range(8)}))
    found = [
        match(rectify(rig, 0, 1, ORIGIN), picture, picture, nothing > 0, Bounds(nothing, nothing, nothing)),
        fill(nothing, nothing > 0),
        *complete(nothing, nothing, nothing, nothing),
        *hull[0],
    ]
    assert depth_error(nothing, nothing, nothing.astype(np.uint8), rig, 0, range(8)) is None
    only_ssim = MetricsParams(measures=["ssim"])
    assert {region for region, _ in measure(picture, picture, nothing.astype(np.uint8), only_ssim)} == {"full"}
    return worst(apart(f, 0) for f in found)


EDGES = np.array([[-0.9, -0.5, 0.0, 3.5, 3.9]])
"""Columns beside and on a depth map four pixels wide."""


def naive_edge() -> float:
    """Bilinear with zeros beside the picture, as `grid_sample` pads."""
    found = cv2.remap(
        np.full((4, 4), 2, np.float32),
        EDGES.astype(np.float32),
        np.ones_like(EDGES, np.float32),
        cv2.INTER_LINEAR,
        borderValue=0,
    )
    return apart(found, 2)


def naive_cut() -> float:
    """Share of a wide pair's surface that is not counted when disparities from 512 px on are thrown away, as one
    data set's loader does."""
    pixels = opencv(pair_rig(60), BODY)[0]
    return float((np.abs(pixels[1, :, 0] - pixels[0, :, 0]) >= 512).mean())


def uncounted() -> float:
    rig = pair_rig(60)
    truth = sphere_depth(rig, 0, ORIGIN, 0.6)
    found = depth_error(truth, truth, np.where(truth > 0, 255, 0).astype(np.uint8), rig, 0, range(2))
    return 1.0 if found is None else 1 - found.pixels / float((truth > 0).sum())


def round_trip(size: tuple[int, int], shift: float) -> float:
    """Px by which unprojected pixels miss the middle of their pixel, when centres are taken `shift` px off."""
    rig = rig_of([camera(on_ring(20), ORIGIN)], size, 50.0)
    depth = np.random.default_rng(0).uniform(1, 3, size[::-1])
    k = rig.intrinsics[0].copy()
    k[:2, 2] += shift
    pixels = project(unproject(depth, k, rig.world_to_camera[0]), rig.intrinsics[0], rig.world_to_camera[0])[0]
    rows, columns = np.mgrid[: size[1], : size[0]] + 0.5
    return float(np.linalg.norm(pixels - np.stack([columns, rows], axis=-1), axis=-1).max())


def soft_masks() -> tuple[Rig, dict[int, np.ndarray]]:
    rig = ring(8, (48, 40), 45.0)
    return rig, {v: sphere_mask(rig, v, ORIGIN, 0.5) for v in range(8)}


def naive_thresholds() -> float:
    """Pixels that count in the picture (above one half) and not in the loss (above 0.66 after an erosion), as one
    published loader has it."""
    mask = soft_masks()[1][0]
    return float(((mask > 127) != (cv2.erode(mask, np.ones((3, 3))) > 0.66 * 255)).sum())


def threshold_error() -> float:
    """Pixels of the mask without a depth, and with one beside it."""
    rig, masks = soft_masks()
    hull = hull_only(Geometry.of(rig, tuple(range(8)), DepthParams(method="hull")), Frame({}, masks))
    return float(sum(((hull[v][0] > 0) != foreground(masks[v])).sum() for v in masks))


def sphere_scene() -> tuple[Rig, list[np.ndarray], list[np.ndarray]]:
    """A textured sphere before black: rig, pictures and depths of two views."""
    rig = ring(16, (128, 112), 120.0)
    (a, za), (b, zb) = (textured_sphere(rig, v, ORIGIN, 0.6) for v in (0, 1))
    return rig, [a, b], [za, zb]


def naive_matches() -> tuple[np.ndarray, np.ndarray]:
    """Disparity, px, by plain semi-global matching of the rectified pictures, -33 where nothing is found; and where
    the sphere is."""
    rig, colors, depths = sphere_scene()
    pair = rectify(rig, 0, 1, ORIGIN)
    window = (0, 0, *pair.size)
    rectified = [cv2.remap(c, *pair.maps(i, window), cv2.INTER_LINEAR) for i, c in enumerate(colors)]
    surface = cv2.remap((depths[0] > 0).astype(np.uint8), *pair.maps(0, window), cv2.INTER_NEAREST) > 0
    return cv2.StereoSGBM.create(minDisparity=-32, numDisparities=64, blockSize=5).compute(*rectified) / 16, surface


def naive_background() -> float:
    """Pixels before black that are given a depth."""
    found, surface = naive_matches()
    return float(((found > -33) & ~surface).sum())


def bounds_around(depth: np.ndarray) -> Bounds:
    near, far = (np.where(depth > 0, depth + d, 0).astype(np.float32) for d in (-0.3, 0.6))
    return Bounds(depth.astype(np.float32), near, far)


def matches() -> np.ndarray:
    """Our depth of the first view."""
    rig, colors, depths = sphere_scene()
    return match(rectify(rig, 0, 1, ORIGIN), *colors, depths[0] > 0, bounds_around(depths[0]))


def matched_background() -> float:
    """Searched everywhere: nothing but the mask says where the sphere ends."""
    rig, colors, depths = sphere_scene()
    wide = Bounds(*(np.full(depths[0].shape, z, np.float32) for z in (2.0, 1.3, 2.6)))
    found = match(rectify(rig, 0, 1, ORIGIN), *colors, depths[0] > 0, wide)
    return float(((found > 0) & ~(depths[0] > 0)).sum())


def hidden_scene() -> tuple[Rig, list[np.ndarray], list[np.ndarray], np.ndarray]:
    """A small sphere before a large one, two views, and which pixels of the first view the second cannot see."""
    rig = ring(16, (160, 144), 150.0)
    colors, depths = [], []
    for v in (0, 1):
        (far, z), (near, front) = textured_sphere(rig, v, ORIGIN, 0.6), textured_sphere(rig, v, 0.48 * on_ring(0), 0.16)
        nearer = (front > 0) & ((z == 0) | (front < z))
        colors.append(np.where(nearer[..., None], 255 - near, far))
        depths.append(np.where(nearer, front, z))
    points = unproject(depths[0], rig.intrinsics[0], rig.world_to_camera[0])
    pixels, z = project(points, rig.intrinsics[1], rig.world_to_camera[1])
    column, row = np.clip(pixels[..., 0].astype(int), 0, 159), np.clip(pixels[..., 1].astype(int), 0, 143)
    return rig, colors, depths, (depths[0] > 0) & (z > depths[1][row, column] + 0.1) & (depths[1][row, column] > 0)


@cache
def hidden_matches() -> tuple[np.ndarray, np.ndarray]:
    """Depth of both views, each matched with the other and searched from 0.8 to 2.1 m."""
    rig, colors, depths, _ = hidden_scene()
    bounds = [Bounds(*(np.where(z > 0, limit, 0).astype(np.float32) for limit in (1.3, 0.8, 2.1))) for z in depths]
    first, second = (
        match(rectify(rig, a, b, ORIGIN), colors[a], colors[b], depths[a] > 0, bounds[a]) for a, b in ((0, 1), (1, 0))
    )
    return first, second


def wrong_where_hidden(checked: bool) -> float:
    """Share of the hidden pixels that keep a match which is more than 1.5 px off."""
    rig, _, depths, hidden = hidden_scene()
    found, pair = hidden_matches(), rectify(rig, 0, 1, ORIGIN)
    kept = found[0] > 0
    if checked:
        errors = disagreement(found[0], found[1], transfer(rig, 0, 1), pair.sensitivity)
        scale = np.array([pair.sensitivity])
        kept = fuse(found[0][None], errors[None], scale, DepthParams().consistency)[0] > 0
    off = pair.sensitivity * np.abs(1 / np.where(kept, found[0], 1) - 1 / np.where(hidden, depths[0], 1))
    return float((kept & (off > 1.5))[hidden].mean())


def naive_square() -> float:
    """A grid of side S for a map that is S wide and not as high."""
    depth = np.ones((48, 64))
    side = depth.shape[1]
    columns, rows = np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5)
    return apart(np.stack([columns * depth, rows * depth], axis=-1), pixel_centres((64, 48)))


CASES = (
    Case(
        "R1",
        "pairs above one another, diagonal, or on their side",
        "no columns differ: depth is 0 / 0, and nobody objects",
        "m",
        lambda: worst(naive_stereo_depth(r) for r in VERTICAL),
        lambda: worst(stereo_depth_error(r) for r in [*VERTICAL, *WIDE, UNEVEN]),
        1e-12,
        "pictures are turned until the baseline runs along their rows; float64",
    ),
    Case(
        "R2",
        "pairs up to 90 degrees apart",
        "the body leaves the rectified pictures",
        "of the body",
        lambda: worst(naive_lost(r) for r in WIDE),
        lambda: worst(lost(r) for r in [*WIDE, *OPPOSITE]),
        0.02,
        "principal points follow the subject; wider than 105 degrees is not matched",
    ),
    Case(
        "D1",
        "depth below half a metre in 16 bits",
        "inverse depth times 2^15 wraps: 0.4 m reads as 2 m, 0.499 m as 250 m",
        "m",
        naive_stored,
        stored_error,
        1.2e-7,
        "kept in metres in float32; integer depth files are refused",
    ),
    Case(
        "D2",
        "disparities of hundreds of px in float16",
        "steps of half a px",
        "m",
        naive_flow,
        kept_depth_error,
        1.2e-7,
        "depth is kept, in float32; disparities never are",
    ),
    Case(
        "D3",
        "disparity zero or negative",
        "1 / (d + 1e-8): points millions of kilometres off, or behind the camera",
        "m",
        naive_farthest,
        farthest,
        0.0,
        "no point: depth is 0 there, or masked and counted",
    ),
    Case(
        "D4",
        "an empty mask",
        "the mean of nothing is not a number, and every mean over it",
        "of a value",
        lambda: float(np.mean(np.zeros(0))),
        empty_mask_error,
        0.0,
        "depth and hull are 0, a measure has no row",
    ),
    Case(
        "D9",
        "looking up beside the picture",
        "zeros beside it pull depth to the camera",
        "m",
        naive_edge,
        lambda: apart(sample(np.full((4, 4), 2, np.float32), EDGES, np.ones_like(EDGES), 0.02), 2),
        1e-6,
        "what is unknown drops out of the weights; float32",
    ),
    Case(
        "D10",
        "disparities above 512 px in wide pairs",
        "thrown away: a part of the surface is never looked at",
        "of the surface",
        naive_cut,
        uncounted,
        0.0,
        "searched and measured about the surface, whatever the disparity",
    ),
    Case(
        "D11",
        "the half pixel between two conventions",
        "maps with integer centres, unprojected with centres at a half",
        "px",
        lambda: round_trip((64, 48), 0.5),
        lambda: round_trip((64, 48), 0.0),
        1e-9,
        "one convention; `storage/model/cameras.py` alone converts; float64",
    ),
    Case(
        "D12",
        "soft masks",
        "other thresholds for the picture and for what is counted: a rim that is neither",
        "pixels",
        naive_thresholds,
        threshold_error,
        0.0,
        "one threshold: depth lies on the mask exactly",
    ),
    Case(
        "D13",
        "black or textureless background",
        "matched all the same",
        "pixels",
        naive_background,
        matched_background,
        0.0,
        "only pixels of the mask are matched, or counted",
    ),
    Case(
        "D14",
        "what the other camera cannot see",
        "a depth is found for it, any",
        "of the hidden pixels",
        lambda: wrong_where_hidden(False),
        lambda: wrong_where_hidden(True),
        0.3,
        "a match must be confirmed from the other side within 1.5 px;"
        " of one pair and a pattern that repeats, chance confirms some",
    ),
    Case(
        "D15",
        "pictures that are not square",
        "width taken for height",
        "px",
        naive_square,
        lambda: round_trip((64, 48), 0.0),
        1e-9,
        "float64",
    ),
)
