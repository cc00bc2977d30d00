"""Who judges, who teaches, and that no Gaussian sees its own picture alone."""

from itertools import pairwise

import numpy as np
import pytest

from stages.capture.person import capture_person
from stages.refinement.schedule import FEWEST, Schedule, schedule


def of(views: int, usable: tuple[int, ...] | None = None) -> Schedule | None:
    person = capture_person(views=views, size=16, frames=1, held_out=0)
    chosen = np.isin(np.arange(views), range(views) if usable is None else usable)
    return schedule(person.rig, person.views.sources, chosen)


@pytest.mark.parametrize(("views", "usable"), [(8, None), (8, (0, 1, 2, 5)), (8, (0, 3, 6)), (3, None), (6, (0, 1, 2, 3))])
def test_the_judges_picture_is_never_trained_on_and_no_picture_of_the_judge_has_its_own_gaussians(views: int, usable: tuple[int, ...] | None) -> None:
    plan = of(views, usable)
    assert plan is not None
    everybody = set(range(views) if usable is None else usable)
    assert plan.judge.target not in {lesson.target for lesson in plan.lessons}
    assert plan.judge.target not in {v for v, _ in plan.judge.parts}
    assert {lesson.target for lesson in plan.lessons} == everybody - {plan.judge.target}
    assert {v for lesson in (*plan.lessons, plan.judge) for v, _ in lesson.parts} <= everybody


@pytest.mark.parametrize(("views", "usable"), [(8, None), (8, (0, 1, 2, 5)), (8, (0, 3, 6)), (3, None), (6, (0, 1, 2, 3)), (12, (0, 1, 2, 3, 7))])
def test_gaussians_that_are_trained_on_their_own_picture_are_trained_on_another_too_and_never_alone(views: int, usable: tuple[int, ...] | None) -> None:
    plan = of(views, usable)
    assert plan is not None
    for lesson in plan.lessons:
        parts = [v for v, _ in lesson.parts]
        if lesson.target in parts:
            assert len(set(parts)) > 1
            assert any(lesson.target in [v for v, _ in other.parts] and other.target != lesson.target for other in plan.lessons)


def test_views_without_gaussians_make_no_picture_and_too_few_make_no_schedule() -> None:
    assert of(6, (0, 1)) is None
    assert of(6, ()) is None
    assert of(6, tuple(range(FEWEST))) is not None


def test_neighbours_are_the_two_nearest_and_targets_follow_one_another_from_afar() -> None:
    plan = of(8)
    assert plan is not None
    assert plan.judge.target == 0
    for lesson in (*plan.lessons[::2], plan.judge):  # each is followed by one with its own Gaussians
        assert {(v - lesson.target) % 8 for v, _ in lesson.parts} == {1, 7}
        np.testing.assert_allclose([w for _, w in lesson.parts], 1, atol=1e-3)
    targets = [lesson.target for lesson in plan.lessons[::2]]
    assert all(min((a - b) % 8, (b - a) % 8) > 1 for a, b in pairwise(targets))
    assert plan.courses == (plan.lessons, plan.lessons[::2])
