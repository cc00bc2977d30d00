"""The width of edges is the blur they were made with, whatever their contrast, and its errors are stated."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.inspection.sharpness import edge_width


def boxes(blur: float, contrast: float = 150.0, noise: float = 0.0) -> np.ndarray:
    """Tilted bright boxes on grey, drawn eight times finer and averaged down: a pixel's own width is 0.29."""
    fine = np.full((200 * 8, 240 * 8), 50.0, np.float32)
    for x in range(3):
        corners = cv2.boxPoints(((500 + 500 * x, 800), (260, 900), 10 + 20 * x)).astype(np.int32)
        cv2.fillConvexPoly(fine, corners, 50 + contrast)
    gray = cv2.resize(
        cv2.GaussianBlur(fine, (0, 0), 8 * blur) if blur else fine, (240, 200), interpolation=cv2.INTER_AREA
    )
    gray = gray + noise * np.random.default_rng(1).normal(size=gray.shape)
    return np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize("blur", [0.7, 1.0, 2.0, 3.0])
def test_the_blur_is_found(blur: float) -> None:
    """Within a sixth: pixels add their own width, and the upper quartile is a little above the middle."""
    found = edge_width(boxes(blur))
    assert found == pytest.approx(np.hypot(blur, 0.29), rel=0.17)


def test_contrast_does_not_count_and_noise_hardly() -> None:
    assert edge_width(boxes(1.5, 60.0)) == pytest.approx(edge_width(boxes(1.5, 180.0)), rel=0.05)
    assert edge_width(boxes(1.5, 150.0, noise=3.0)) == pytest.approx(edge_width(boxes(1.5)), rel=0.15)


def test_nothing_is_said_of_a_picture_without_edges_or_without_pixels() -> None:
    assert edge_width(np.full((100, 100, 3), 90, np.uint8)) is None
    assert edge_width(boxes(1.0), (0, 0, 8, 8)) is None


def test_only_the_region_is_looked_at() -> None:
    picture = np.concatenate([boxes(0.7), boxes(3.0)], axis=1)
    assert edge_width(picture, (0, 0, 240, 200)) < 1.2 < 2.5 < edge_width(picture, (240, 0, 480, 200))
