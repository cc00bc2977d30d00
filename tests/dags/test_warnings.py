"""What a kernel notes and what a check finds: both are kept in the receipt, and a run tells them."""

from pathlib import Path

import pytest

from dags.events import TaskDone
from dags.plan import Selection
from tests.pipeline import Pipeline, receipts


def test_a_kernels_note_reaches_the_receipt_and_the_run(finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the rendering stage notes Gaussians that it had to leave out."""
    pipeline = finished.copy(tmp_path / "archive")
    monkeypatch.setattr("stages.rendering.run.masked_note", lambda masked, partition: (f"{masked.size} Gaussians of frame {partition.start} were not finite and were left out",))
    events = pipeline.run(selection=Selection(only=frozenset({"rendering"}), force=frozenset({"rendering"})))
    said = {e.task.partition: e.receipt.warnings for e in events if isinstance(e, TaskDone)}
    assert said == {p: (f"2 Gaussians of frame {2 * p} were not finite and were left out",) for p in range(3)}
    assert receipts(pipeline) == receipts(finished)  # a warning is no content
