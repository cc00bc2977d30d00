import numpy as np
import pytest

from benchmarks.depth.motorcycle import FOLDER, Pair, bad, by_sweep, load


def test_the_surest_answers_are_counted_over_what_is_known() -> None:
    truth = np.array([[5.0, 5, 5, 5, np.inf]], np.float32)
    pair = Pair(np.zeros((1, 5, 3), np.uint8), np.zeros((1, 5, 3), np.uint8), truth)
    found, trust = np.array([[5.0, 8, np.nan, 6.5, 90]]), np.array([[0.9, 0.5, 0.0, 0.8, 1.0]])
    assert bad(pair, found, trust, 0.5) == (0.5, 0.0)
    assert bad(pair, found, trust) == (0.75, pytest.approx(1 / 3))


@pytest.mark.skipif(not FOLDER.is_dir(), reason=f"{FOLDER} is missing (POSEGAUSSIAN_CAPTURES)")
def test_the_sweep_of_a_measured_pair_is_dense_and_mostly_right() -> None:
    pair = load()
    part = Pair(pair.left[150:350], pair.right[150:350], pair.disparity[150:350])
    density, wrong = bad(part, *by_sweep(part), 0.8)
    assert density > 0.79
    # The engine's rows are the hardest of the picture; the whole picture stays below 0.045 at a density of 0.85.
    assert wrong < 0.09
