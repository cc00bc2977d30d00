"""Frames are made ahead, in the order of need, no further than the bound; what waits for them can be stopped."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.training.frame_producers import ProducedFrames, Producers, QueuedFrame, read_frame
from posegaussian.stages.training.config import TrainingConfig
from tests.support import fake_frames

CONFIG = TrainingConfig(depth_steps=400, joint_steps=0, window=3, steps_per_frame=2)
OF_VALIDATION = {f"{s}-00.npz" for s in range(8000, 8004)}


@pytest.fixture
def producers(tmp_path: Path) -> Iterator[Producers]:
    found = Producers(CONFIG, tmp_path, "tests.support.fake_frames", 1)
    yield found
    found.close()


def frames_of(producers: Producers) -> ProducedFrames:
    return ProducedFrames(CONFIG, producers, lambda step: fake_frames.frames_of_step(CONFIG, step), print)


def files(producers: Producers) -> set[str]:
    return {f.name for f in producers.folder.glob("[0-9]*.npz")}


def names(numbers: range) -> set[str]:
    return {QueuedFrame.training(CONFIG, i).file for i in numbers}


def wait_until_idle(producers: Producers) -> None:
    deadline = time.monotonic() + 60
    while producers.queue or any(item for _, item in producers.busy.values()):
        producers.poll(0.1)
        assert time.monotonic() < deadline


def test_frames_are_made_ahead_no_further_than_the_bound(producers: Producers) -> None:
    frames = frames_of(producers)
    found = frames.of_step(0, lambda: True)
    assert found is not None
    assert list(found) == [0, 1, 2]
    wait_until_idle(producers)
    assert files(producers) == names(range(3 + frames.limit)) | OF_VALIDATION
    assert frames.ahead == frames.limit
    made = producers.made
    assert frames.of_step(3, lambda: True) is not None
    assert list(frames.held) == [1, 2, 3], "what is behind is let go"
    wait_until_idle(producers)
    assert files(producers) == names(range(4 + frames.limit)) | OF_VALIDATION
    assert producers.made == made + 1


def test_what_is_needed_now_goes_before_what_is_needed_later(producers: Producers) -> None:
    later, now = [[QueuedFrame.training(CONFIG, i) for i in r] for r in (range(5), range(3, 7))]
    producers.order(later)
    producers.order(now, first=True)
    assert [i.index for i in producers.queue] == [3, 4, 5, 6, 0, 1, 2]
    producers.order(later)
    assert len(producers.queue) == 7, "nothing is asked for twice"


def test_who_waits_for_frames_can_be_stopped(tmp_path: Path) -> None:
    without_workers = Producers(CONFIG, tmp_path, "tests.support.fake_frames", 0)
    assert frames_of(without_workers).of_step(0, lambda: False) is None
    assert frames_of(without_workers).of_validation(lambda: False) is None
    assert not files(without_workers)


def test_a_frame_comes_back_as_it_was_made(tmp_path: Path) -> None:
    without_workers = Producers(CONFIG, tmp_path, "tests.support.fake_frames", 0)
    found = frames_of(without_workers).of_step(0, lambda: True)
    assert found is not None
    for name, array in fake_frames.make_frame(CONFIG, 2).items():
        np.testing.assert_array_equal(found[2][name], array)
    assert sorted(read_frame(tmp_path / QueuedFrame.training(CONFIG, 2).file)) == ["x", "y"]
