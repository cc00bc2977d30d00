"""How bright a picture is by its background: found as it was put on, whoever stands before it, and taken back."""

import numpy as np
import pytest

from posegaussian.stages.imaging.color import to_linear, to_srgb
from posegaussian.stages.imaging.steady_light import UNTOLD, steadied, stops_brighter
from posegaussian.stages.survey.algorithms.plate import brighter_than_each_other, median_and_spread

SIDE = 160
EVERYWHERE = np.ones((SIDE, SIDE), bool)


def room(seed: int = 0) -> np.ndarray:
    """[SIDE, SIDE, 3] float: a wall of coloured tiles."""
    tiles = np.random.default_rng(seed).uniform(50, 190, (SIDE // 8, SIDE // 8, 3))
    return tiles.repeat(8, axis=0).repeat(8, axis=1)


def filmed(wall: np.ndarray, stops: np.ndarray, noise: float = 0.0, covered: float = 0.0, seed: int = 0) -> np.ndarray:
    """A wall under other light and noise, a person of another colour before a share of it."""
    rng = np.random.default_rng(seed)
    shown = wall.copy()
    shown[:, : round(covered * SIDE)] = rng.uniform(20, 235, (SIDE, round(covered * SIDE), 3))
    lit = to_srgb(to_linear(shown) * 2.0**stops) + rng.normal(0, noise, shown.shape)
    return np.clip(np.rint(lit), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("covered", [0.0, 0.4])
@pytest.mark.parametrize("stops", [np.array([0.2, 0.2, 0.2]), np.array([-0.3, -0.1, 0.05])])
def test_light_is_found_whoever_stands_before_the_wall(stops: np.ndarray, covered: float) -> None:
    plate = filmed(room(), np.zeros(3))
    found = stops_brighter(filmed(room(), stops, noise=3.0, covered=covered), plate, EVERYWHERE)
    # A hundredth of a stop is 0.7 %; the noise of 25,000 pixels is far below, what of the person fits by chance is not.
    np.testing.assert_allclose(found, stops, atol=0.01)


def test_a_picture_is_brought_back_to_its_usual_light() -> None:
    plate, bright = filmed(room(), np.zeros(3)), filmed(room(), np.array([0.3, 0.2, -0.1]))
    back = steadied(bright, stops_brighter(bright, plate, EVERYWHERE))
    # Both were rounded, and a step of the darker one is up to 1.1 of the other.
    assert np.abs(back.astype(int) - plate).max() <= 2


def test_a_camera_whose_light_stays_is_left_as_it_is_to_the_bit() -> None:
    plate = filmed(room(), np.zeros(3))
    walked_past = filmed(room(), np.zeros(3), covered=0.3)
    found = stops_brighter(walked_past, plate, EVERYWHERE)
    assert np.abs(found).max() < 1e-3
    assert (steadied(walked_past, found) == walked_past).all()


def test_what_hides_most_of_the_wall_tells_nothing() -> None:
    plate = filmed(room(), np.zeros(3))
    hidden = filmed(room(), np.full(3, 0.2), covered=0.8)
    found = stops_brighter(hidden, plate, EVERYWHERE)
    assert (found == UNTOLD).all()
    assert steadied(hidden, found) is hidden
    known = np.zeros_like(EVERYWHERE)
    known[:, round(0.8 * SIDE) :] = True
    np.testing.assert_allclose(stops_brighter(hidden, plate, known), 0.2, atol=0.01)


def test_a_plate_of_pictures_made_steady_is_that_of_a_steady_camera() -> None:
    """Somebody walks past under light that changes: the background is as sharp as under light that does not."""
    drift = 0.25 * np.sin(np.arange(9))[:, None] * np.array([1.0, 0.9, 1.1])
    covered = np.zeros((9, SIDE, SIDE), np.uint8)
    alike, changing = (
        np.stack([filmed(room(), d * on, noise=1.0, seed=i) for i, d in enumerate(drift)]) for on in (0, 1)
    )
    for i in range(9):
        for stack in (alike, changing):
            stack[i, 30:, 16 * i : 16 * i + 24] = (200, 40, 40)
    found = brighter_than_each_other(changing, covered)
    # All are told against one of them, whichever it is.
    np.testing.assert_allclose(found - found[4], drift - drift[4], atol=0.02)
    # The plate is rounded: half a step of 255 is 0.01 stops of its light.
    assert np.abs(brighter_than_each_other(alike, covered)).max() < 0.01
    (plate, spread), (_, rough) = (
        median_and_spread(stack, covered)
        for stack in (np.stack([steadied(p, s) for p, s in zip(changing, found, strict=True)]), changing)
    )
    offset = stops_brighter(plate, median_and_spread(alike, covered)[0], EVERYWHERE)
    assert np.abs(steadied(plate, offset).astype(int) - median_and_spread(alike, covered)[0]).mean() < 1.5
    assert np.median(spread) <= 2 < 6 < np.median(rough)
