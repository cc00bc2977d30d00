"""Who judges, and in which order the others teach."""

from itertools import pairwise

import numpy as np
import pytest

from posegaussian.stages.refinement.params import FEWEST
from posegaussian.stages.refinement.schedule import Schedule, schedule
from posegaussian.stages.simulator.subjects.capsule_person import capture_person


def of(views: int, usable: tuple[int, ...] | None = None) -> Schedule | None:
    person = capture_person(views=views, size=16, frames=1, held_out=0)
    chosen = np.isin(np.arange(views), range(views) if usable is None else usable)
    return schedule(person.rig, person.views.sources, chosen)


@pytest.mark.parametrize(
    ("views", "usable"), [(8, None), (8, (0, 1, 2, 5)), (8, (0, 3, 6)), (3, None), (6, (0, 1, 2, 3))]
)
def test_one_view_judges_and_every_other_one_teaches(views: int, usable: tuple[int, ...] | None) -> None:
    plan = of(views, usable)
    assert plan is not None
    everybody = set(range(views) if usable is None else usable)
    assert set(plan.pupils) == everybody - {plan.judge}
    assert len(plan.pupils) == len(set(plan.pupils))
    assert {v for v, _ in plan.neighbours} <= set(plan.pupils)


def test_views_without_gaussians_make_no_picture_and_too_few_make_no_schedule() -> None:
    assert of(6, (0, 1)) is None
    assert of(6, ()) is None
    assert of(6, tuple(range(FEWEST))) is not None


def test_neighbours_are_the_two_nearest_and_pictures_follow_one_another_from_afar() -> None:
    plan = of(8)
    assert plan is not None
    assert plan.judge == 0
    assert {v for v, _ in plan.neighbours} == {1, 7}
    np.testing.assert_allclose([w for _, w in plan.neighbours], 1, atol=1e-3)
    assert all(min((a - b) % 8, (b - a) % 8) > 1 for a, b in pairwise(plan.pupils))
