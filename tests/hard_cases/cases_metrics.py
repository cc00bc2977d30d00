"""Records L1-L7: measures of pictures and of depth. Losses of training are in cases_training.py."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.metrics.depth_error import depth_error, nearest_pair
from posegaussian.stages.metrics.measures.lpips_network import ALEX, Network
from posegaussian.stages.metrics.measures.ms_ssim import WEIGHTS, ms_ssim
from posegaussian.stages.metrics.measures.psnr import psnr
from posegaussian.stages.metrics.measures.ssim import ssim_map
from tests.hard_cases.catalogue import Case, apart, worst
from tests.stages.metrics.test_lpips import by_hand, made_weights
from tests.support.known_geometry import ring, sphere_depth

LEVELS = (0.0, 0.6, 1.0)


def nearly_constant(level: float) -> tuple[np.ndarray, np.ndarray]:
    x = np.full((32, 32), level)
    return x, x + 1e-7 * np.random.default_rng(3).normal(size=x.shape)


def naive_ssim(x: np.ndarray, y: np.ndarray, data_range: float, dtype: type = np.float32) -> np.ndarray:
    """Wang et al., 2004: variances as means of squares less squares of means."""
    x, y = x.astype(dtype), y.astype(dtype)
    c1, c2 = dtype((0.01 * data_range) ** 2), dtype((0.03 * data_range) ** 2)
    mx, my, xx, yy, xy = (cv2.GaussianBlur(p, (11, 11), 1.5) for p in (x, y, x * x, y * y, x * y))
    return (2 * mx * my + c1) * (2 * (xy - mx * my) + c2) / ((mx**2 + my**2 + c1) * (xx - mx**2 + yy - my**2 + c2))


def picture(seed: int = 5, side: int = 176) -> np.ndarray:
    """Smooth enough to have structure at every scale, 0..255."""
    x = cv2.GaussianBlur(np.random.default_rng(seed).uniform(0, 255, (side, side)), (0, 0), 4)
    return 255 * (x - x.min()) / (x.max() - x.min())


def naive_ms_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """Mean similarity of every scale to the power of its weight, and their product."""
    value = 1.0
    for weight in WEIGHTS:
        value *= naive_ssim(x, y, 255.0, np.float64).mean() ** weight
        x, y = (cv2.resize(p, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for p in (x, y))
    return float(value)


def naive_mean_psnr() -> float:
    """The mean over two pictures, one of which is perfect."""
    x = picture()
    return float(np.mean([10 * np.log10(255**2 / np.mean((x - y) ** 2)) for y in (x, x + 10)]))


def mean_psnr_error() -> float:
    """Against the mean of the cap and of the other picture's value."""
    x = picture()
    return abs(float(np.mean([psnr(x, y, 255.0, 100.0) for y in (x, x + 10)])) - (100 + 20 * np.log10(25.5)) / 2)


def network() -> Network:
    """AlexNet's stack with made weights."""
    trunk, heads = made_weights(ALEX)
    weights = {c.key: (trunk[f"{c.key}.weight"], trunk[f"{c.key}.bias"]) for c in ALEX.layers}
    return Network(ALEX, weights, tuple(heads[f"lin{i}.model.1.weight"].reshape(-1) for i in range(5)))


def noisy_pair() -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 255, (2, 37, 50, 3))


def lpips_truth() -> float:
    return by_hand("lpips_alex", *noisy_pair(), *made_weights(ALEX))


def naive_lpips() -> float:
    """Pictures of 0..1 given to a network that wants -1..1: the same as darker pictures of half the contrast."""
    shifted = (noisy_pair() / 255 + 1) / 2
    return abs(network().distance(*shifted, 1.0) / lpips_truth() - 1)


def naive_range() -> float:
    """Pictures of 0..1 measured with a range of 2, as one published evaluation does."""
    x, y = (
        p / 255 for p in (picture(), np.clip(picture() + np.random.default_rng(6).normal(0, 30, (176, 176)), 0, 255))
    )
    return abs(float(ssim_map(x, y, 2.0).mean()) - float(ssim_map(x, y, 1.0).mean()))


def range_error() -> float:
    x, y = picture(), np.clip(picture() + np.random.default_rng(6).normal(0, 30, (176, 176)), 0, 255)
    return max(
        apart(ssim_map(x / 255, y / 255, 1.0), ssim_map(x, y, 255.0)),
        abs(psnr(x / 255, y / 255, 1.0, 100.0) - psnr(x, y, 255.0, 100.0)),
    )


def depths() -> tuple[np.ndarray, np.ndarray]:
    """A depth 3 % too far, everywhere, and the truth, which is 0 beside a sphere."""
    truth = sphere_depth(ring(8, (64, 48)), 0, np.zeros(3), 0.6)
    return np.where(truth > 0, 1.03 * truth, 2.0), truth


def naive_depth_error() -> float:
    depth, truth = depths()
    return float(np.abs(1 / depth - 1 / truth).mean())


def depth_measure_error() -> float:
    """Against the same mean over the sphere's pixels, one by one."""
    depth, truth = depths()
    rig = ring(8, (64, 48))
    pair = nearest_pair(rig, 0, range(8))
    found = depth_error(depth, truth, np.full(truth.shape, 255, np.uint8), rig, 0, range(8))
    rows, columns = np.nonzero(truth)
    ratio = pair.rectified_pixels(0, np.stack([columns, rows], axis=-1) + 0.5)[1]
    by_pixel = pair.focal * abs(pair.baseline) * np.abs(1 / depth[rows, columns] - 1 / truth[rows, columns]) / ratio
    return np.inf if found is None else abs(found.epe - float(by_pixel.mean()))


CASES = (
    Case(
        "L1",
        "SSIM of nearly constant pictures",
        "the variance cancels and turns negative: more similar than equal",
        "of SSIM",
        lambda: worst(apart(naive_ssim(*nearly_constant(v), 1.0), 1) for v in LEVELS),
        lambda: worst(apart(ssim_map(*nearly_constant(v), 1.0), 1) for v in LEVELS),
        1e-9,
        "float64: squares of 1 leave 1e-16 beside the constant of 9e-4",
    ),
    Case(
        "L1b",
        "MS-SSIM of a picture and its negative",
        "a negative mean to the power of 0.0448",
        "of MS-SSIM",
        lambda: naive_ms_ssim(picture(), 255 - picture()),
        lambda: ms_ssim(picture(), 255 - picture(), 255.0),
        0.0,
        "a term that is negative counts as 0, in the definition that every row carries",
    ),
    Case(
        "L2",
        "PSNR of identical pictures",
        "infinite, and every mean it enters",
        "dB",
        lambda: naive_mean_psnr() - (100 + 20 * np.log10(25.5)) / 2,
        mean_psnr_error,
        1e-9,
        "capped at `psnr_cap`, 100 dB; float64",
    ),
    Case(
        "L3",
        "LPIPS of pictures in 0..1",
        "the network wants -1..1: another number under the same name",
        "of LPIPS",
        naive_lpips,
        lambda: worst(abs(network().distance(*noisy_pair() * r / 255, r) / lpips_truth() - 1) for r in (1.0, 255.0)),
        1e-5,
        "the range is an argument; float32. Pictures too small for the last layer are refused",
    ),
    Case(
        "L4",
        "SSIM of pictures in 0..1",
        "measured with a range of 2",
        "of SSIM",
        naive_range,
        range_error,
        1e-9,
        "one range, in the definition that every row carries; float64",
    ),
    Case(
        "L7",
        "depth errors where there is no true depth",
        "1 / 0",
        "px",
        naive_depth_error,
        depth_measure_error,
        1e-9,
        "only pixels with a true depth count; float64",
    ),
)
