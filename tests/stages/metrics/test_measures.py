"""PSNR and SSIM against published values, and where they tend to break."""

import os
from pathlib import Path

import numpy as np
import pytest

from posegaussian.stages.metrics.measures.psnr import psnr
from posegaussian.stages.metrics.measures.ssim import ssim_map

REFERENCE = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "reference" / "ssim"


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray]:
    if not (REFERENCE / "camera.png").exists():
        pytest.skip(f"{REFERENCE} is not here; set POSEGAUSSIAN_CAPTURES to the folder that holds reference/")
    import cv2

    return tuple(cv2.imread(str(REFERENCE / n), cv2.IMREAD_GRAYSCALE) for n in ("camera.png", "cam_noisy_seed5.png"))  # type: ignore[return-value]


def test_psnr_equals_the_published_value(pair: tuple[np.ndarray, np.ndarray]) -> None:
    assert psnr(pair[1], pair[0], 255.0, 100.0) == pytest.approx(22.409353363576034, abs=1e-4)


def test_ssim_equals_the_published_value(pair: tuple[np.ndarray, np.ndarray]) -> None:
    """IPOL measures where the window lies inside the picture, so the border of half a window is left out here."""
    similarity = ssim_map(pair[1], pair[0], 255.0)
    assert similarity.shape == pair[0].shape
    assert similarity[5:-5, 5:-5].mean() == pytest.approx(0.357959091663361, abs=1e-3)
    assert similarity[5:-5, 5:-5].mean() == pytest.approx(0.357964, abs=1e-6)  # plain numpy and OpenCV


def test_ssim_by_its_definition_at_one_pixel() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 255, (2, 21, 21))
    g = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    w = np.outer(g, g) / g.sum() ** 2
    a, b = x[5:16, 5:16], y[5:16, 5:16]
    ma, mb = (w * a).sum(), (w * b).sum()
    va, vb, c = (w * (a - ma) ** 2).sum(), (w * (b - mb) ** 2).sum(), (w * (a - ma) * (b - mb)).sum()
    c1, c2 = 2.55**2, 7.65**2
    expected = (2 * ma * mb + c1) * (2 * c + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))
    assert ssim_map(x, y, 255.0)[10, 10] == pytest.approx(expected, abs=1e-12)


def test_the_border_is_the_mirrored_picture() -> None:
    """Edges are reflected with the edge pixel repeated:
    the map of a picture is the map of it beside its mirror image."""
    x, y = np.random.default_rng(6).uniform(0, 255, (2, 20, 18))
    beside = ssim_map(np.hstack([x, x[:, ::-1]]), np.hstack([y, y[:, ::-1]]), 255.0)
    np.testing.assert_allclose(ssim_map(x, y, 255.0)[:, 9:], beside[:, 9:18], atol=1e-12)


def test_scaling_picture_and_range_together_changes_nothing() -> None:
    x, y = np.random.default_rng(1).uniform(0, 1, (2, 20, 30, 3))
    np.testing.assert_allclose(ssim_map(x, y, 1.0), ssim_map(255 * x, 255 * y, 255.0), atol=1e-12)
    assert psnr(x, y, 1.0, 100.0) == pytest.approx(psnr(255 * x, 255 * y, 255.0, 100.0))


def test_identical_pictures() -> None:
    x = np.random.default_rng(2).integers(0, 256, (24, 24, 3), np.uint8)
    assert psnr(x, x, 255.0, 100.0) == 100.0
    assert psnr(x, x, 255.0, 60.0) == 60.0
    np.testing.assert_allclose(ssim_map(x, x, 255.0), 1, atol=1e-12)


@pytest.mark.parametrize("level", [0.0, 0.6, 254.0])
def test_l1_nearly_constant_pictures(level: float) -> None:
    """In float32 the variances turn negative and SSIM is off by 5e-5."""
    x = np.full((32, 32), level)
    y = x + 1e-7 * np.random.default_rng(3).normal(size=x.shape)
    similarity = ssim_map(x, y, 255.0)
    assert np.isfinite(similarity).all()
    assert np.abs(similarity - 1).max() < 1e-9
    assert similarity.max() <= 1 + 1e-12


@pytest.mark.parametrize("shape", [(1, 1), (3, 20), (11, 11, 3)])
def test_pictures_smaller_than_the_window(shape: tuple[int, ...]) -> None:
    x, y = np.random.default_rng(4).uniform(0, 255, (2, *shape))
    assert ssim_map(x, y, 255.0).shape == shape[:2]
    assert np.abs(ssim_map(x, y, 255.0)).max() <= 1


def test_opposite_pictures_stay_within_bounds() -> None:
    x = np.random.default_rng(5).integers(0, 2, (40, 40)) * 255
    assert ssim_map(x, 255 - x, 255.0).min() >= -1


def test_what_cannot_be_compared_is_refused() -> None:
    x = np.zeros((4, 4))
    for measure in (lambda a, b: psnr(a, b, 255.0, 100.0), lambda a, b: ssim_map(a, b, 255.0)):
        with pytest.raises(ValueError, match="equal shape"):
            measure(x, np.zeros((4, 5)))
        with pytest.raises(ValueError, match="at least one pixel"):
            measure(x[:0], x[:0])
        with pytest.raises(ValueError, match="NaN"):
            measure(x + np.nan, x)
