"""Steps: how far one moves what is optimised, and what of many is kept."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.stages.refinement.steps.attributes import SharedGaussians
from posegaussian.stages.refinement.steps.optimise import (
    FEW_PICTURES,
    NEWEST,
    RATES,
    USUAL_PICTURES,
    HostWalk,
    _Adam,
    fitting_rates,
    rates_of,
)
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from tests.stages.refinement.walks import begun


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=5, size=40, frames=1, held_out=0)


@pytest.fixture
def walk(person: PersonCapture) -> HostWalk:
    return HostWalk(*begun(person))


def test_what_is_kept_is_the_mean_over_steps_the_newest_weighing_most(walk: HostWalk) -> None:
    expected = {name: np.zeros_like(a) for name, a in walk.gaussians.offsets.items()}
    for _ in range(7):
        walk.step()
        for name, a in walk.gaussians.offsets.items():
            expected[name] = (1 - NEWEST) * expected[name] + NEWEST * a
    for name, mean in expected.items():
        np.testing.assert_allclose(walk.reached.offsets[name], mean, rtol=1e-4, atol=1e-7)  # float32, seven sums
        assert not np.array_equal(walk.reached.offsets[name], walk.gaussians.offsets[name])


def test_looking_at_the_mean_moves_nothing(walk: HostWalk) -> None:
    walk.step()
    before = {name: a.copy() for name, a in walk.gaussians.offsets.items()}
    walk.reached.gaussians()
    walk.reached.lists()
    for name, a in before.items():
        np.testing.assert_array_equal(walk.gaussians.offsets[name], a)


@settings(max_examples=20)
@given(st.integers(1, 64), st.floats(1e-3, 1e3))
def test_the_first_move_is_the_rate_of_so_many_pictures_whatever_the_slope(pictures: int, slope: float) -> None:
    offsets = {name: np.zeros((1, 3), np.float32) for name in RATES}
    free = SimpleNamespace(offsets=offsets, confine=lambda: None)
    _Adam(free, rates_of(pictures, RATES)).step(
        {name: np.full((1, 3), slope, np.float32) for name in RATES}, slower=1.0
    )  # type: ignore[arg-type]
    less = np.sqrt(USUAL_PICTURES / max(pictures, FEW_PICTURES))
    for name, rate in RATES.items():
        np.testing.assert_allclose(offsets[name], -rate * less, rtol=1e-4)


@pytest.mark.parametrize(("tall", "finer"), [(0, 1), (100, 1), (440, 1), (880, 2), (1760, 4), (2400, 4)])
def test_rates_in_pixels_grow_with_how_large_the_pictures_show_the_subject(tall: int, finer: int) -> None:
    """The middle picture's, along its longer side; in metres a step is as long as in a picture half as large."""
    covers = [np.zeros((2500, 20), np.float32) for _ in range(3)]
    covers[0][50 : 50 + tall, 3:9] = 0.5
    covers[1] = covers[0].T
    covers[2][:2000] = 1
    rates = fitting_rates([SimpleNamespace(cover=c) for c in covers])  # type: ignore[misc]
    assert rates == pytest.approx({n: r * (finer if n in ("depth", "shift") else 1) for n, r in RATES.items()})


def test_other_offsets_leave_the_gaussians_they_come_from_alone(walk: HostWalk) -> None:
    own = walk.gaussians.offsets
    other = walk.gaussians.with_offsets({name: a + np.float32(0.01) for name, a in own.items()})
    assert isinstance(other, SharedGaussians)
    assert walk.gaussians.offsets is own
    assert not np.array_equal(other.gaussians().mean.detach(), walk.gaussians.gaussians().mean.detach())
