"""Laws of time: partitions tile the frames, spans clip, ranges select what a slow reference selects."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.storage.model.timegrid import TimeGrid, parse_range, select

QUICK = settings(max_examples=50)
grids = st.builds(TimeGrid, frames=st.integers(0, 40), length=st.integers(1, 12))


@QUICK
@given(grids)
def test_partitions_cover_every_frame_once_in_order(grid: TimeGrid) -> None:
    assert [f for p in grid.partitions for f in grid.bounds(p)] == list(range(grid.frames))
    assert all(len(grid.bounds(p)) == grid.length for p in list(grid.partitions)[:-1])


@QUICK
@given(grids, st.integers(0, 50), st.integers(0, 50))
def test_a_span_is_the_partition_and_its_halo_clipped_to_the_sequence(grid: TimeGrid, before: int, after: int) -> None:
    for p in grid.partitions:
        own = grid.bounds(p)
        wanted = [f for f in range(own.start - before, own.stop + after) if 0 <= f < grid.frames]
        assert list(grid.span(p, (before, after))) == wanted
        assert grid.span(p, (0, 0)) == own


@QUICK
@given(grids, st.integers(0, 40), st.integers(0, 40))
def test_touched_partitions_are_exactly_those_that_hold_frames_of_the_span(grid: TimeGrid, a: int, b: int) -> None:
    span = range(min(a, b, grid.frames), min(max(a, b), grid.frames))
    wanted = [p for p in grid.partitions if set(grid.bounds(p)) & set(span)]
    assert list(grid.touched(span)) == wanted


def test_a_partition_holds_at_least_one_frame() -> None:
    with pytest.raises(ValueError, match="at least 1 frame, got 0"):
        TimeGrid(10, 0)


part = st.none() | st.integers(0, 30)


@QUICK
@given(st.lists(st.integers(0, 40), unique=True, max_size=20).map(sorted), part, part, st.none() | st.integers(1, 7))
def test_select_agrees_with_a_slow_reference(
    numbers: list[int], start: int | None, stop: int | None, stride: int | None
) -> None:
    text = ":".join("" if p is None else str(p) for p in (start, stop, stride))
    first = start if start is not None else (numbers[0] if numbers else 0)
    allowed = {first + k * (stride or 1) for k in range(100)}
    wanted = [n for n in numbers if n in allowed and (stop is None or n < stop)]
    assert select(numbers, text).tolist() == wanted


@QUICK
@given(part, part, st.none() | st.integers(1, 7), st.sampled_from(["", " "]))
def test_a_range_parses_to_its_parts(start: int | None, stop: int | None, stride: int | None, pad: str) -> None:
    text = ":".join(pad + ("" if p is None else str(p)) + pad for p in (start, stop, stride))
    assert parse_range(text) == (start, stop, stride if stride is not None else 1)


def test_two_parts_are_enough_and_pictures_numbered_from_one_keep_their_phase() -> None:
    assert parse_range("3:9") == (3, 9, 1)
    assert select(range(1, 8), "::2").tolist() == [1, 3, 5, 7]
    assert select(np.array([], dtype=np.int64), "0:5:2").tolist() == []


@pytest.mark.parametrize(
    "text", ["", "5", "a:b", "1.5:3", "0:9:0", "0:9:-1", "-1:5", "0:-5", "0:1:2:3", "0:x:2", "start:stop:stride"]
)
def test_a_fault_of_a_range_names_the_text(text: str) -> None:
    with pytest.raises(ValueError, match="range") as error:
        parse_range(text)
    assert repr(text) in str(error.value)
