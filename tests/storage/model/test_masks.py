"""A line that was drawn along a picture's edges is no subject, and one that an edge cuts off is."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.storage.model.masks import foreground, line_widths, rim_share, without_line

SIDES = ("top", "right", "bottom", "left")


def standing(cut: int = 0) -> np.ndarray:
    """[90, 120] uint8 of somebody whom the lower edge cuts off `cut` px higher, soft along the outline."""
    mask = np.zeros((90, 120), np.uint8)
    mask[20 : 80 + cut, 40:70] = 255
    mask[20 : 80 + cut, [39, 70]] = 100
    return mask


def drawn(mask: np.ndarray, widths: tuple[int, ...], value: int = 255) -> np.ndarray:
    out = mask.copy()
    for side, width in enumerate(widths):
        np.rot90(out, side)[:width] = value
    return out


@pytest.mark.parametrize("widths", [(1, 1, 1, 1), (3, 2, 1, 2), (0, 0, 2, 0), (0, 1, 0, 0), (0, 0, 0, 0)])
@pytest.mark.parametrize("cut", [0, 10], ids=["whole", "cut off"])
def test_a_line_is_found_and_cleared_and_a_subject_keeps_its_pixels(widths: tuple[int, ...], cut: int) -> None:
    mask = standing(cut)
    lined = drawn(mask, widths)
    assert line_widths(foreground(lined)) == widths
    cleared = without_line(lined, widths)
    np.testing.assert_array_equal(cleared, mask)
    assert rim_share(foreground(cleared)) == rim_share(foreground(mask)) < 0.1


def test_what_compression_leaves_beside_a_line_is_cleared_with_it() -> None:
    lined = drawn(drawn(standing(), (2, 2, 2, 2), 60), (1, 1, 1, 1))
    np.testing.assert_array_equal(without_line(lined, line_widths(foreground(lined))), standing())


def test_a_subject_that_fills_the_picture_or_comes_from_its_edge_is_no_line() -> None:
    near = np.zeros((90, 120), np.uint8)
    for row in range(90):
        near[row, max(2, 60 - row) : 118] = 255  # shoulders that fill the lower edge
    for mask in (
        near,
        standing(10),
        255 - standing(),
        np.full((90, 120), 255, np.uint8),
        drawn(near * 0, (4, 4, 4, 4)),
    ):
        assert line_widths(foreground(mask)) == (0, 0, 0, 0)
    assert line_widths(np.ones((3, 3), bool)) == (0, 0, 0, 0)
