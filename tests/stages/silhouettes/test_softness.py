"""How soft masks are, whatever they show."""

import cv2
import numpy as np
import pytest

from posegaussian.stages.silhouettes.softness import softness
from posegaussian.stages.simulator.subjects.capsule_person import capture_person


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    return capture_person(views=4, size=96, frames=1, held_out=0).mask[0]


def blurred(mask: np.ndarray, width: float) -> np.ndarray:
    """Risen by 80 % over so many px, where the outline is straight."""
    return np.asarray(cv2.GaussianBlur(mask, (0, 0), width / 2.563))


@pytest.mark.parametrize("width", [2.0, 3.0, 4.0])
def test_it_is_the_width_over_which_mattes_rise(exact: np.ndarray, width: float) -> None:
    """An outline that runs along pixels has as many sides as px, a slanted one up to 1.41 times; corners widen."""
    found = softness([blurred(mask, width) for mask in exact])
    assert width / 1.45 < found < 1.3 * width


def test_exact_masks_are_less_than_a_pixel_soft_and_softer_ones_are_softer(exact: np.ndarray) -> None:
    widths = [softness([blurred(mask, w) for mask in exact]) for w in (0.1, 1.0, 1.5, 2.0, 3.0, 5.0)]
    assert softness(exact) < 1
    assert widths == sorted(widths)


def test_it_does_not_hang_on_where_or_how_a_person_stands(exact: np.ndarray) -> None:
    soft = [blurred(mask, 3.0) for mask in exact]
    found = softness(soft)
    assert softness([np.pad(mask, ((7, 0), (0, 11))) for mask in soft]) == found
    assert softness([mask.T for mask in soft]) == found
    assert softness(soft[::-1]) == found


def test_without_an_outline_there_is_none() -> None:
    assert softness([]) == softness([np.zeros((8, 8), np.uint8), np.full((8, 8), 255, np.uint8)]) == 0
