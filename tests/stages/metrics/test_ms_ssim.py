"""MS-SSIM against its definition in plain numpy, and where it has no value."""

import numpy as np
import pytest

from posegaussian.stages.metrics.measures.ms_ssim import SMALLEST, ms_ssim

PUBLISHED = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)


def by_definition(x: np.ndarray, y: np.ndarray, data_range: float) -> float:
    """One channel: every window one by one, as sums over sliding views."""
    g = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    w = np.outer(g, g) / g.sum() ** 2
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    value = 1.0
    for scale, weight in enumerate(PUBLISHED):
        if scale:
            x, y = (
                p[: p.shape[0] // 2 * 2, : p.shape[1] // 2 * 2].reshape(p.shape[0] // 2, 2, -1, 2).mean(axis=(1, 3))
                for p in (x, y)
            )
        a, b = (np.lib.stride_tricks.sliding_window_view(p, (11, 11)) for p in (x, y))
        ma, mb = (np.einsum("ijkl,kl->ij", p, w) for p in (a, b))
        va, vb, c = (
            np.einsum("ijkl,kl->ij", a * a, w) - ma**2,
            np.einsum("ijkl,kl->ij", b * b, w) - mb**2,
            np.einsum("ijkl,kl->ij", a * b, w) - ma * mb,
        )
        contrast = (2 * c + c2) / (va + vb + c2)
        term = contrast.mean() if scale < 4 else (contrast * (2 * ma * mb + c1) / (ma**2 + mb**2 + c1)).mean()
        value *= term**weight
    return float(value)


def pair(h: int, w: int, channels: tuple[int, ...] = (), noise: float = 30) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 255, (h, w, *channels))
    for _ in range(3):  # smooth enough to have structure at the coarsest scale
        x = (x + np.roll(x, 1, 0) + np.roll(x, 1, 1) + np.roll(x, 7, 0)) / 4
    x = 255 * (x - x.min()) / (x.max() - x.min())
    return x, np.clip(x + rng.normal(0, noise, x.shape), 0, 255)


def test_the_definition() -> None:
    x, y = pair(176, 192)
    assert ms_ssim(x, y, 255.0) == pytest.approx(by_definition(x, y, 255.0), abs=1e-12)
    assert 0.1 < ms_ssim(x, y, 255.0) < 0.95


def test_colour_is_the_mean_over_channels_and_the_order_of_pictures_does_not_matter() -> None:
    x, y = pair(176, 180, (3,))
    assert ms_ssim(x, y, 255.0) == pytest.approx(
        np.mean([ms_ssim(x[..., c], y[..., c], 255.0) for c in range(3)]), abs=1e-14
    )
    assert ms_ssim(x, y, 255.0) == ms_ssim(y, x, 255.0)


def test_scaling_picture_and_range_together_changes_nothing() -> None:
    x, y = pair(170, 165)
    assert ms_ssim(x / 255, y / 255, 1.0) == pytest.approx(ms_ssim(x, y, 255.0), abs=1e-12)


def test_an_odd_side_is_a_picture_whose_last_row_is_repeated() -> None:
    """The finest scale sees one row of windows more; with equal pictures there, the coarser scales are the same."""
    x, y = pair(177, 177)
    from posegaussian.stages.metrics.measures.ms_ssim import _halved

    for p in (x, y):
        np.testing.assert_array_equal(_halved(p[..., None]), _halved(np.pad(p, (0, 1), mode="edge")[..., None]))
        assert _halved(p[..., None]).shape == (89, 89, 1)


def test_more_noise_is_less_similar() -> None:
    values = [ms_ssim(*pair(180, 180, noise=n), 255.0) for n in (0, 5, 20, 60)]
    assert values[0] == pytest.approx(1, abs=1e-12)
    assert values == sorted(values, reverse=True)


def test_l3_a_picture_against_its_negative_is_zero_and_no_nan() -> None:
    x, _ = pair(180, 180, (3,))
    assert ms_ssim(x, 255 - x, 255.0) == 0
    mixed = x.copy()
    mixed[..., 0] = 255 - x[..., 0]
    assert ms_ssim(x, mixed, 255.0) == pytest.approx(2 / 3)


def test_nearly_constant_pictures() -> None:
    x = np.full((170, 170), 254.0)
    y = x + 1e-7 * np.random.default_rng(3).normal(size=x.shape)
    assert ms_ssim(x, y, 255.0) == pytest.approx(1, abs=1e-9)
    assert ms_ssim(x, x * 0, 255.0) < 0.5


def test_the_smallest_picture_and_what_is_refused() -> None:
    assert SMALLEST == 161
    x, y = pair(SMALLEST, SMALLEST + 3)
    assert 0 < ms_ssim(x, y, 255.0) < 1
    with pytest.raises(ValueError, match="161 px or more"):
        ms_ssim(x[1:], y[1:], 255.0)
    with pytest.raises(ValueError, match="equal shape"):
        ms_ssim(x, y[:, 1:], 255.0)
    with pytest.raises(ValueError, match="NaN"):
        ms_ssim(x + np.nan, y, 255.0)
