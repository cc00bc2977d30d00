from hypothesis import given
from hypothesis import strategies as st

from posegaussian.dags.runtime.executors.prefetch import AHEAD, MOST, RECENT, Window


def after(least: int, seconds: float, count: int = RECENT) -> int:
    window = Window(least)
    for _ in range(count):
        window.note(seconds)
    return window.tasks


def test_long_tasks_keep_the_window_of_the_setting() -> None:
    assert after(2, 1.0) == 2
    assert after(1, 60.0) == 1


def test_tasks_of_milliseconds_widen_it_up_to_a_bound() -> None:
    assert after(2, 0.0) == after(2, 0.001) == MOST
    assert after(2, AHEAD / 4) == 4
    assert after(20, 0.001) == 20, "a setting beyond the bound stands"


def test_a_few_short_tasks_prove_nothing() -> None:
    assert after(2, 0.001, RECENT - 1) == 2


@given(st.integers(1, 64), st.lists(st.floats(0, 1e6), max_size=40))
def test_it_is_never_less_than_asked_for_nor_more_than_the_bound_or_the_setting(
    least: int, seconds: list[float]
) -> None:
    window = Window(least)
    for s in seconds:
        window.note(s)
    assert least <= window.tasks <= max(least, MOST)
