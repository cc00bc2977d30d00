"""Reading what a run made: arrays of finished partitions, against their receipts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.tasks import PRODUCERS
from posegaussian.storage.archive.receipts import Output
from posegaussian.storage.archive.shards import read_frames
from posegaussian.storage.model.errors import ShardMissing


class Results:
    """The finished outputs of one sequence."""

    def __init__(self, context: Context, book: Book | None = None) -> None:
        """Reads the receipts, unless a plan has them in its book; no data yet."""
        self.context = context
        self._outputs: dict[str, dict[tuple[int, int | None], Output]] = {}
        for task, receipt in (book or Book.open(context)).receipts.items():
            for output in receipt.outputs:
                self._outputs.setdefault(output.array, {})[
                    task.partition if task.partition is not None else 0, output.view
                ] = output

    def has(self, array: str) -> bool:
        """Whether any partition of an array is finished."""
        return array in self._outputs

    def views_of(self, array: str) -> list[int]:
        """Views of which any partition of an array is finished, ascending."""
        return sorted({view for _, view in self._outputs.get(array, {}) if view is not None})

    def read(self, array: str, frames: range, view: int | None = None) -> np.ndarray:
        """[len(frames), ...] of one view. Raises ShardMissing where a partition is not finished."""
        outputs = self._outputs.get(array)
        if outputs is None:
            raise ShardMissing(f"array {array} of sequence {self.context.sequence.name} was never made; run first")
        for p in self.context.grid.touched(frames):
            if (p, view) in outputs and outputs[p, view].dropped:
                raise ShardMissing(
                    f"array {array} of sequence {self.context.sequence.name}, partition {p}, was dropped to save space;"
                    f" set keep: {{{array}: always}} and `run --force` the stage that makes it"
                )
        return read_frames(self.context.sequence, array, outputs, self.context.grid, frames, view)

    def iterate(self, array: str, view: int | None = None) -> Iterator[tuple[int, np.ndarray]]:
        """(frame index, [...]) of all frames, one partition in memory at a time."""
        for partition in self.context.grid.partitions:
            frames = self.context.grid.bounds(partition)
            yield from zip(frames, self.read(array, frames, view), strict=True)

    def table(self, template: str, path: str) -> list[dict[str, Any]]:
        """All rows of a table, with the partition's order kept."""
        assert template in PRODUCERS, f"no stage writes {template}"
        return self.rows(
            o for _, o in sorted(self._outputs.get(template.format(path=path), {}).items(), key=lambda kv: kv[0][0])
        )

    def rows(self, outputs: Iterable[Output]) -> list[dict[str, Any]]:
        """All rows of some outputs of a table, one after the other."""
        import pyarrow.parquet as pq

        return [
            row
            for o in outputs
            for f in o.files
            for row in pq.read_table(self.context.sequence.place(f.key)).to_pylist()
        ]
