"""Exposures that differ by known stops are found around shared points."""

from __future__ import annotations

import numpy as np

from stages.inspection.light import FEWEST, stops_apart
from stages.survey.surface import colors_at


def test_known_stops_are_found_from_pairs() -> None:
    random = np.random.default_rng(1)
    stops = np.array([[0.0, 0, 0], [1.0, 1.2, 0.8], [0.0, 0, 0], [0, 0, 0]])
    pairs = {(a, b): stops[a] - stops[b] + 0.1 * random.normal(size=(40, 3)) for a, b in ((0, 1), (1, 2), (0, 2))}
    found = stops_apart(pairs, 4)
    assert found is not None
    np.testing.assert_allclose(found[0][:3], stops[:3], atol=0.1)
    assert found[1][3] == np.inf
    assert (found[1][:3] < 0.1).all()


def test_few_points_tell_nothing() -> None:
    assert stops_apart({(0, 1): np.ones((FEWEST - 1, 3))}, 2) is None
    assert stops_apart({}, 2) is None


def test_clipped_and_black_colours_do_not_count() -> None:
    picture = np.full((40, 60, 3), 128, np.uint8)
    picture[:, :20], picture[:, 40:] = 2, 255
    found = colors_at(picture, np.array([[5.0, 20.0], [30.0, 20.0], [55.0, 20.0]]), blur=1.0)
    assert (found[[0, 2]] == 0).all()
    np.testing.assert_allclose(found[1], 0.2159, atol=1e-3)  # sRGB 128 is 21.6 % of white
