import cv2
import numpy as np
import pytest

from posegaussian.stages.frames.effects import FEWEST_POINTS, SCATTERED, proven_offsets
from posegaussian.stages.imaging.outline import moved

SCALE = 8


def disc(radius: float) -> np.ndarray:
    """A disc of 120 x 120 px with soft edges, exact to an eighth of a px."""
    big = np.zeros((120 * SCALE, 120 * SCALE), np.uint8)
    cv2.circle(big, (60 * SCALE, 62 * SCALE), round(radius * SCALE), 255, -1)
    return cv2.resize(big, (120, 120), interpolation=cv2.INTER_AREA)


def radius(mask: np.ndarray) -> float:
    return float(np.sqrt(mask.sum(dtype=np.float64) / 255 / np.pi))


@pytest.mark.parametrize("inwards", [-2.5, -1.0, -0.4, 0.4, 1.0, 1.5, 3.0])
def test_an_outline_moves_by_what_is_asked(inwards: float) -> None:
    mask = disc(40)
    # Distances are taken between pixel centres: across a slanted outline that is up to a fifth of a px off.
    assert radius(moved(mask, inwards)) == pytest.approx(radius(mask) - inwards, abs=0.25)


def test_there_and_back_is_nearly_where_it_was() -> None:
    mask = disc(30)
    back = moved(moved(mask, 1.3), -1.3).astype(int)
    assert np.abs(back - mask).max() < 128
    assert np.abs(back - mask).mean() < 1


def test_what_has_no_outline_and_what_need_not_move_stays() -> None:
    for mask in (np.zeros((20, 20), np.uint8), np.full((20, 20), 255, np.uint8)):
        assert np.array_equal(moved(mask, 2.0), mask)
    assert moved(disc(20), 0.0) is not None
    assert np.array_equal(moved(disc(20), 0.0), disc(20))


def test_far_from_the_outline_soft_values_stay() -> None:
    mask = disc(40)
    mask[58:66, 58:66] = 180
    mask[2, 2] = 60
    out = moved(mask, 1.0)
    assert (out[58:66, 58:66] == 180).all()
    assert out[2, 2] == 60


def test_few_points_and_scattered_edges_prove_nothing() -> None:
    rows = np.array(
        [
            [1.4, 0.5, FEWEST_POINTS],
            [1.4, 0.5, FEWEST_POINTS - 1],
            [1.4, SCATTERED + 0.1, 5000],
            [-1.1, 0.3, 900],
            [0, 0, 0],
        ]
    )
    assert proven_offsets(rows).tolist() == [1.4, 0, 0, -1.1, 0]
