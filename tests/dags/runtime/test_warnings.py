"""What a kernel notes and what a check finds: both are kept in the receipt, and a run tells them."""

from pathlib import Path

import pytest

from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import TaskDone
from tests.support.pipeline import Pipeline, receipts


def test_a_kernels_note_reaches_the_receipt_and_the_run(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the rendering stage notes Gaussians that it had to leave out."""
    pipeline = finished.copy(tmp_path / "archive")
    monkeypatch.setattr(
        "posegaussian.stages.rendering.run.masked_note",
        lambda masked, numbers: (f"{masked.size} Gaussians of frame {numbers[0]} were not finite and were left out",),
    )
    events = pipeline.run(selection=Selection(only=frozenset({"rendering"}), force=frozenset({"rendering"})))
    said = {e.task.partition: e.receipt.warnings for e in events if isinstance(e, TaskDone)}
    assert said == {p: (f"2 Gaussians of frame {2 * p} were not finite and were left out",) for p in range(3)}
    assert receipts(pipeline) == receipts(finished)  # a warning is no content


def test_frames_are_named_by_the_source_s_numbers(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frame 0 of a range that starts at 2 is the source's frame 2."""
    pipeline = finished.copy(tmp_path / "archive").with_settings("frames.range=2:4")
    told: list[list[int]] = []
    monkeypatch.setattr(
        "posegaussian.stages.rendering.run.masked_note",
        lambda masked, numbers: told.append([int(n) for n in numbers]) or (),
    )
    pipeline.run(selection=Selection(force=frozenset({"rendering"})))
    assert told == [[2, 3]]
