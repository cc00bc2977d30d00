"""FLIP against the published numbers of its authors' test pictures."""

import os
from pathlib import Path

import numpy as np
import pytest

from posegaussian.stages.metrics.measures.flip import flip_map, missing

FOLDER = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "reference" / "flip"
PPD = 67.02064


@pytest.fixture(autouse=True)
def _package() -> None:
    pytest.importorskip("flip_evaluator", reason="flip-evaluator is not installed; `pip install 'posegaussian[flip]'`")


def test_the_published_numbers() -> None:
    if not (FOLDER / "tree-ref.png").exists():
        pytest.skip(f"{FOLDER} is not here; set POSEGAUSSIAN_CAPTURES to the folder that holds reference/")
    import cv2

    truth, picture = (cv2.imread(str(FOLDER / n))[..., ::-1] for n in ("tree-ref.png", "tree-test.png"))
    seen = flip_map(picture, truth, 255.0, PPD).astype(np.float64)
    assert seen.shape == truth.shape[:2]
    # published by another implementation of the same code, with a tolerance of 1e-4
    assert seen.mean() == pytest.approx(0.133285, abs=1e-4)
    assert seen.min() == pytest.approx(0, abs=1e-4)
    assert seen.max() == pytest.approx(0.983044, abs=1e-4)
    ordered = np.sort(seen.ravel())
    weight = np.cumsum(ordered) / ordered.sum()
    assert [ordered[np.searchsorted(weight, q)] for q in (0.25, 0.5, 0.75)] == pytest.approx(
        [0.184924, 0.333241, 0.503441], abs=1e-4
    )


def test_equal_pictures_have_no_difference_and_a_change_is_seen_where_it_is() -> None:
    x = np.random.default_rng(0).uniform(0, 255, (40, 60, 3))
    assert flip_map(x, x, 255.0, PPD).max() < 1e-6
    y = x.copy()
    y[10:14, 40:44] = 255 - y[10:14, 40:44]
    seen = flip_map(y, x, 255.0, PPD)
    assert np.unravel_index(seen.argmax(), seen.shape) > (8, 38)
    assert seen[10:14, 40:44].mean() > 0.3
    assert seen[:, :20].max() < 1e-6


def test_the_range_is_the_data_range_and_resolution_matters() -> None:
    x, y = np.random.default_rng(1).uniform(0, 1, (2, 30, 30, 3))
    np.testing.assert_allclose(flip_map(x, y, 1.0, PPD), flip_map(x * 255, y * 255, 255.0, PPD), atol=2e-6)  # float32
    assert flip_map(x, y, 1.0, 20).mean() > flip_map(x, y, 1.0, 200).mean()  # from afar noise is not seen


def test_what_cannot_be_compared_is_refused() -> None:
    x = np.zeros((4, 4, 3))
    with pytest.raises(ValueError, match="equal shape"):
        flip_map(x, x[:3], 255.0, PPD)
    with pytest.raises(ValueError, match="at least one pixel"):
        flip_map(x[:0], x[:0], 255.0, PPD)
    for bad in (np.nan, -1, 256):
        with pytest.raises(ValueError, match=r"outside 0\.\.255"):
            flip_map(x + bad, x, 255.0, PPD)
    assert missing() is None
