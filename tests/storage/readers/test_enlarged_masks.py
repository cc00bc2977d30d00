"""Masks smaller than their pictures, and those that a program enlarged in blocks: outlines stay where they are and get
no steps and no softness that the subject has not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from posegaussian.storage.model.masks import crispness, without_blocks
from posegaussian.storage.readers.images import resized

SIZE = 384
SMALLER = [(192, 192), (226, 226), (128, 128), (96, 96)]


@pytest.fixture(scope="module")
def masks() -> np.ndarray:
    """[V, h, w] uint8 of a kicking person, exact."""
    return capture_person(3, SIZE, 1, 0, motion="kick").mask[0]


def averaged(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return cv2.resize(mask, size, interpolation=cv2.INTER_AREA)


def hard(mask: np.ndarray) -> np.ndarray:
    return np.uint8(255) * (mask > 127)


def off(found: np.ndarray, exact: np.ndarray) -> float:
    """Share of the mask that is wrong."""
    return float(np.abs(found.astype(float) - exact).sum() / exact.sum())


@pytest.mark.parametrize("size", SMALLER)
@pytest.mark.parametrize(("made", "of_linear"), [(averaged, 0.35), (lambda m, s: hard(averaged(m, s)), 0.8)])
def test_a_smaller_mask_is_enlarged_to_sharper_edges_than_between_its_pixels(
    masks: np.ndarray, size: tuple[int, int], made: object, of_linear: float
) -> None:
    """A third of the error where soft pixels tell where an outline runs, four fifths where none do."""
    assert callable(made)
    for exact in masks:
        small = made(exact, size)
        linear = cv2.resize(small, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
        assert off(resized(small, (SIZE, SIZE)), exact) < of_linear * off(linear, exact)


@pytest.mark.parametrize("size", SMALLER)
def test_a_matte_that_rises_over_several_pixels_stays_as_soft(masks: np.ndarray, size: tuple[int, int]) -> None:
    for mask in masks:
        soft = cv2.GaussianBlur(mask, (0, 0), 1.5 * SIZE / size[0])
        small = averaged(soft, size)
        assert crispness(small) == 0
        linear = cv2.resize(small, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
        assert off(resized(small, (SIZE, SIZE)), soft) < off(linear, soft)


@pytest.mark.parametrize("size", SMALLER)
@pytest.mark.parametrize("way", [cv2.INTER_NEAREST, cv2.INTER_NEAREST_EXACT])
@pytest.mark.parametrize("values", [hard, lambda m: m], ids=["hard", "soft"])
def test_the_mask_that_blocks_were_made_of_is_found(
    masks: np.ndarray, size: tuple[int, int], way: int, values: object
) -> None:
    """Or one whose blocks begin at the same rows and columns wherever it changes, which shows the same."""
    assert callable(values)
    for exact in masks:
        small = values(averaged(exact, size))
        blocks = cv2.resize(small, (SIZE, SIZE), interpolation=way)
        found = without_blocks(blocks)
        assert found.shape != blocks.shape
        np.testing.assert_allclose(found.shape, small.shape, rtol=0.02)
        now = off(resized(found, (SIZE, SIZE)), exact)
        assert now < 0.9 * off(blocks, exact)
        if SIZE % size[0] == 0:
            np.testing.assert_array_equal(found, small)


@pytest.mark.parametrize("values", [hard, lambda m: m], ids=["hard", "soft"])
def test_a_mask_with_pixels_of_its_own_is_left_alone(masks: np.ndarray, values: object) -> None:
    assert callable(values)
    for exact in masks:
        mask = values(exact)
        assert without_blocks(mask) is mask
    square = np.zeros((SIZE, SIZE), np.uint8)
    for empty_or_plain in (square, square + np.uint8(255), np.pad(square[100:-100, 100:-100] + np.uint8(255), 100)):
        assert without_blocks(empty_or_plain) is empty_or_plain


def test_sizes_that_are_alike_change_nothing(masks: np.ndarray) -> None:
    mask = masks[0]
    assert resized(mask, (SIZE, SIZE)) is mask
    assert crispness(hard(masks[0])) == 1
    assert crispness(np.zeros((8, 8), np.uint8)) == 1
